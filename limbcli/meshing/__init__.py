"""Volume meshes: of a site's block and of a limb, their layers, bones and quality."""
