#!/bin/sh
# iso2mesh 0.6.7 (its Python package): the surface of a ball of radius 10 mm in tetrahedra, by `volface`, saved
# with the mesh's nodes as STL (`savestl`, `savebinstl`) and as OFF (`saveoff`).
# Guess: one surface, 4153 mm3: the package counts nodes from 1 throughout, as in MATLAB.
# Seen:  OFF has it. STL has 1097 mm3: it counts from 0, so that each corner is the node after the right one.
#        The surface is closed and as large as the ball, and no word is said, as long as nodes follow that are
#        not on the surface, as in meshes of TetGen.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q iso2mesh==0.6.7 trimesh==5.2.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import iso2mesh
import numpy as np
import trimesh

folder = Path(sys.argv[1])
ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
nodes = np.vstack([ball.vertices, np.zeros((1, 3))])  # the last one is the middle
faces = np.array(ball.faces) + 1
surface = iso2mesh.volface(np.c_[faces, np.full(len(faces), len(nodes))])[0][:, :3]

seen = {}
WRITERS = {"text.stl": iso2mesh.savestl, "binary.stl": iso2mesh.savebinstl, "a.off": iso2mesh.saveoff}
for name, write in WRITERS.items():
    write(nodes, surface, str(folder / name))
    back = trimesh.load(folder / name)
    size = np.ptp(back.bounds, axis=0).round().tolist()
    seen[name] = round(abs(float(back.volume))), bool(back.is_watertight), size
    print(name, seen[name][0], "mm3; closed:", seen[name][1], "size", seen[name][2])
wide = [20, 20, 20]
sys.exit(seen != {"text.stl": (1097, True, wide), "binary.stl": (1097, True, wide), "a.off": (4153, True, wide)})
PYTHON
