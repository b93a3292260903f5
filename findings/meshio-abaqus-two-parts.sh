#!/bin/sh
# meshio 5.3.5: a valid Abaqus input file of two parts, as Abaqus/CAE writes it: each part counts its nodes
# from 1, and *INSTANCE moves one by 100 (Abaqus: "Defining an assembly").
# Guess: two tetrahedra, each at its own nodes, one of them moved.
# Seen:  both tetrahedra are made of the nodes of the part read last: the first body is gone, the second is
#        there twice, and neither is moved. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 2>/dev/null
"$folder/venv/bin/python" - "$folder/a.inp" <<'PYTHON'
import sys
from pathlib import Path

import meshio


def part(name, x):
    nodes = f"*NODE\n1, {x}, 0, 0\n2, {x + 1}, 0, 0\n3, {x}, 1, 0\n4, {x}, 0, 1\n"
    return f"*PART, NAME={name}\n{nodes}*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n*END PART\n"


placed = [f"*INSTANCE, NAME={name}-1, PART={name}\n{line}*END INSTANCE\n" for name, line in
          (("BONE", "0, 0, 100\n"), ("SKIN", ""))]  # fmt: skip
text = f"*HEADING\na\n{part('BONE', 0)}{part('SKIN', 10)}*ASSEMBLY, NAME=A\n{''.join(placed)}*END ASSEMBLY\n"
path = Path(sys.argv[1])
path.write_text(text)
found = meshio.read(path)
corners = [found.points[each.data[0, 0]].tolist() for each in found.cells]
print(len(found.points), "points of 8; first corners of the bone and of the skin:", *corners)
sys.exit((len(found.points), corners) != (4, [[10.0, 0.0, 0.0], [10.0, 0.0, 0.0]]))
PYTHON
