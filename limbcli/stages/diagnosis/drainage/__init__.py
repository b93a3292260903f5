"""Drainage of fluid from a site's tissue, from held indentations simulated by FEBio."""
