#!/bin/sh
# pymeshlab 2025.7.post1: a surface laid on another by `compute_matrix_by_icp_between_meshes`, then saved.
# Guess: the vertices, and the file, are where the surface was laid.
# Seen:  `vertex_matrix` and the saved STL, PLY and OBJ are where it was before, 4.6 mm off; only
#        `transformed_vertex_matrix` has the new place. Distances by pymeshlab (less than 0.1 mm) take the new
#        one, so that all looks well until the limb's file is used elsewhere.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pymeshlab==2025.7.post1 trimesh==5.2.0 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import pymeshlab
import trimesh

folder = Path(sys.argv[1])
limb = trimesh.creation.icosphere(subdivisions=5, radius=40)
limb.vertices = limb.vertices * [1, 0.8, 1.5]
limb.vertices[:, 0] *= 1 + 0.005 * limb.vertices[:, 2]
moved = limb.vertices + [4, 2, 1]
meshes = pymeshlab.MeshSet()
meshes.add_mesh(pymeshlab.Mesh(limb.vertices, limb.faces))
meshes.add_mesh(pymeshlab.Mesh(moved, limb.faces))
meshes.compute_matrix_by_icp_between_meshes(referencemesh=0, sourcemesh=1)
found = {"vertex_matrix": meshes.mesh(1).vertex_matrix()}
found["transformed_vertex_matrix"] = meshes.mesh(1).transformed_vertex_matrix()
for ending in ("stl", "ply", "obj"):
    meshes.set_current_mesh(1)
    meshes.save_current_mesh(str(folder / f"a.{ending}"))
    found[ending] = trimesh.load(folder / f"a.{ending}").vertices
middle = limb.vertices.mean(axis=0)
off = {name: float(np.linalg.norm(each.mean(axis=0) - middle)) for name, each in found.items()}
distance = meshes.get_hausdorff_distance(sampledmesh=1, targetmesh=0)["mean"]
for name, each in off.items():
    print(f"{name}: {each:.2f} mm off")
print(f"mean distance by pymeshlab: {distance:.2f} mm")
laid = off.pop("transformed_vertex_matrix")
sys.exit(not (laid < 0.1 and distance < 0.1 and all(4.5 < each < 4.7 for each in off.values())))
PYTHON
