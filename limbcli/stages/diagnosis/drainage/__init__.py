"""What drains out of the tissue of a site, by held indentations that FEBio simulates."""
