#!/bin/sh
# potpourri3d 1.4.0 and libigl 2.6.3: the way over a surface (heat method) from a point of a limb-like sphere
# of radius 50 mm, in a mesh that also holds a piece of its own, a sphere of radius 10 mm 200 mm aside.
# Guess: no way leads to the other piece: infinity or NaN, as by potpourri3d's own fast marching.
# Seen:  both give every point of the other piece one ordinary length, 78 and 79 mm, about half of the longest
#        way over the limb (157 mm), whether the piece is 200 mm or 2 m aside. No word is said; an island of a
#        scan, or a bone in one file with the skin, counts as near.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q potpourri3d==1.4.0 libigl==2.6.3 trimesh==5.2.0 numpy==2.4.6 scipy==1.17.1 \
  2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import igl
import numpy as np
import potpourri3d
import trimesh

limb = trimesh.creation.icosphere(subdivisions=4, radius=50)


def lengths(aside):
    """On the limb and on the piece, by three ways of finding them."""
    piece = trimesh.creation.icosphere(subdivisions=3, radius=10)
    piece.apply_translation([aside, 0, 0])
    both = trimesh.util.concatenate([limb, piece])
    points, faces = np.array(both.vertices), np.array(both.faces)
    data = igl.HeatGeodesicsData()
    igl.heat_geodesics_precompute(points, faces, data)
    marcher = potpourri3d.MeshFastMarchingDistanceSolver(points, faces)
    found = {"potpourri3d": potpourri3d.MeshHeatMethodDistanceSolver(points, faces).compute_distance(0),
             "libigl": igl.heat_geodesics_solve(data, np.array([0])),
             "fast marching": marcher.compute_distance([[(0, [])]])}
    count = len(limb.vertices)
    return {name: (float(each[:count].max()), float(each[count:].min()), float(each[count:].max()))
            for name, each in found.items()}


same = True
for aside in (200, 2000):
    for name, (own, least, most) in lengths(aside).items():
        print(f"{aside} mm aside, {name}: to {own:.0f} mm on the limb, {least:.0f} to {most:.0f} mm on the piece")
        same &= 154 < own < 158 and (least == most == np.inf if name == "fast marching" else
                                     70 < least <= most < 90 and most - least < 0.1)
sys.exit(not same)
PYTHON
