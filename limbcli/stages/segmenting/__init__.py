"""Parts of `segment` that do not process images: assumed limbs, given surfaces, and the sites' places."""
