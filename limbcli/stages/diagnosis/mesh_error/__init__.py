"""What mesh, cut and contact alone do to a site's curves."""
