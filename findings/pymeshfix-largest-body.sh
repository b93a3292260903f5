#!/bin/sh
# pymeshfix 0.18.1: `repair` of a surface of two closed bodies that need no repair: a limb (radius 50 mm) and
# the bone within it (radius 10 mm).
# Guess: both come back.
# Seen:  only the body of most triangles does, and no word is said: the bone is gone. A finely meshed bone in
#        a coarse skin is what is left in its place. `remove_smallest_components=False` keeps both.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pymeshfix==0.18.1 trimesh==5.2.0 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pymeshfix
import trimesh


def sizes(fine_skin, **options):
    """Widths of the repaired surface, mm, and its number of triangles as a share of those given."""
    skin, bone = (trimesh.creation.icosphere(subdivisions=3 + (is_skin == fine_skin), radius=radius)
                  for is_skin, radius in ((True, 50), (False, 10)))  # fmt: skip
    bone.invert()
    both = trimesh.util.concatenate([skin, bone])
    fixer = pymeshfix.MeshFix(np.array(both.vertices), np.array(both.faces, np.int32))
    fixer.repair(**options)
    return float(np.ptp(fixer.points[:, 0])), len(fixer.faces) / len(both.faces)


seen = [sizes(True), sizes(False), sizes(True, remove_smallest_components=False)]
for name, (wide, share) in zip(("fine skin", "fine bone", "told to keep"), seen, strict=True):
    print(f"{name}: {wide:.0f} mm wide, {share:.0%} of the triangles")
widths, shares = zip(*seen, strict=True)
sys.exit(not (np.allclose(widths, (100, 20, 100), atol=0.1) and np.allclose(shares, (0.8, 0.8, 1))))
PYTHON
