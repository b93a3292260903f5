#!/bin/sh
# trimesh 5.2.0, meshio 5.3.5, pymeshlab 2025.7.post1: a valid OBJ of two bodies whose faces count vertices
# backwards ("f -3 -2 -1": from the vertex read last, paulbourke.net/dataformats/obj).
# Guess: each face takes the last vertices before it, as pymeshlab reads it: one triangle in each body.
# Seen:  trimesh counts from the end of the file: the last body is there twice, the first is gone. meshio
#        keeps negative numbers, one off: taken by numpy, both triangles have corners in both bodies. Neither
#        says so.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 meshio==5.3.5 pymeshlab==2025.7.post1 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/a.obj" <<'PYTHON'
import sys
from pathlib import Path

import meshio
import pymeshlab
import trimesh

path = sys.argv[1]
bodies = [f"v 0 0 {z}\nv 1 0 {z}\nv 0 1 {z}\nf -3 -2 -1\n" for z in (0, 10)]
Path(path).write_text("".join(bodies))
meshes = pymeshlab.MeshSet()
meshes.load_new_mesh(path)
by_meshio, by_meshlab = meshio.read(path), meshes.current_mesh()
by_trimesh = trimesh.load(path, process=False)
seen = {
    "pymeshlab": by_meshlab.vertex_matrix()[by_meshlab.face_matrix()],
    "trimesh": by_trimesh.triangles,
    "meshio": by_meshio.points[by_meshio.cells[0].data],
}
heights = {name: [sorted(set(each[:, 2].tolist())) for each in found] for name, found in seen.items()}
for name, each in heights.items():
    print(f"{name}: heights of the corners of both triangles:", each)
print("meshio's numbers:", by_meshio.cells[0].data.tolist())
same = {"pymeshlab": [[0.0], [10.0]], "trimesh": [[10.0], [10.0]], "meshio": [[0.0, 10.0], [0.0, 10.0]]}
sys.exit(heights != same)
PYTHON
