#!/bin/sh
# trimesh 5.2.0, pymeshlab 2025.7.post1 and VTK 9.7.2 (pyvista 0.49.1): a valid OBJ of a body with an
# L-shaped cross-section, whose ends are faces of six corners, as CAD and modelling programs close a cut;
# written with each of the corners as the first.
# Guess: each reader cuts a face into triangles that cover it once: 3400 mm2.
# Seen:  trimesh makes a fan from the first corner: 3800 or 4200 mm2, whichever corner is the first. Parts
#        of the ends lie twice on each other, once turned. It calls the body watertight, and the volume is
#        right, so that nothing shows it. pymeshlab and VTK have 3400.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 pymeshlab==2025.7.post1 pyvista==0.49.1 vtk==9.7.2 \
    2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/a.obj" <<'PYTHON'
import sys
from pathlib import Path

import pymeshlab
import pyvista as pv
import trimesh

path, L = Path(sys.argv[1]), [(0, 0), (30, 0), (30, 10), (10, 10), (10, 30), (0, 30)]
seen = {"trimesh": [], "pymeshlab": [], "VTK": []}
for first in range(6):
    outline = L[first:] + L[:first]
    sides = ([k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6))
    faces = [[*range(5, -1, -1)], [*range(6, 12)], *sides]
    rows = [f"v {x} {y} {z}" for z in (0, 20) for x, y in outline]
    path.write_text("\n".join(rows + ["f " + " ".join(str(k + 1) for k in each) for each in faces]) + "\n")
    body = trimesh.load(path)
    seen["trimesh"].append(round(float(body.area)))
    assert body.is_watertight and round(float(body.volume)) == 10000
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    seen["pymeshlab"].append(round(meshes.get_geometric_measures()["surface_area"]))
    seen["VTK"].append(round(float(pv.read(path).triangulate().area)))
for name, areas in seen.items():
    print(name, *areas, "mm2")
right = [3400] * 6
sys.exit(seen != {"trimesh": [3800, 3800, 4200, 3800, 3800, 4200], "pymeshlab": right, "VTK": right})
PYTHON
