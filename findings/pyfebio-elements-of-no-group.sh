#!/bin/sh
# pyfebio 0.3.0 and meshio 5.3.5: a block of five tetrahedra, 1000 mm3, of which two are named, "muscle" (as of
# a mesh in which only what gets a load or a material of its own has a group), as a mesh of FEBio by
# `translate_meshio`.
# Guess: five elements, some of them in a part "muscle".
# Seen:  two: what is in no group is left out, and no word is said. The model holds half of the tissue.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyfebio==0.3.0 meshio==5.3.5 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import meshio
import numpy as np
from pyfebio.mesh import translate_meshio

corners = 10.0 * np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
cells = np.array([[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]])


def volume(which):
    a, b, c, d = (corners[cells[which, k]] for k in range(4))
    return round(float(np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))).sum() / 6))


grid = meshio.Mesh(corners, [("tetra", cells)], cell_sets={"muscle": [np.array([0, 4])]})
parts = translate_meshio(grid).elements
seen = {part.name: len(part.all_elements) for part in parts}
print("elements of the FEBio mesh", seen, "of", len(cells), "; volume", volume([0, 4]), "of",
      volume(range(5)), "mm3")
sys.exit(seen != {"muscle": 2} or volume(range(5)) != 1000)
PYTHON
