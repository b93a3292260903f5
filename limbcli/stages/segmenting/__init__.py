"""What `segment` is made of beside images: assumed limbs, given surfaces, and the places of sites."""
