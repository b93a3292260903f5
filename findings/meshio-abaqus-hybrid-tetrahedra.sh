#!/bin/sh
# meshio 5.3.5: a valid Abaqus input file with hybrid linear tetrahedra.
# Guess: C3D4H is read like C3D4, as C3D10H is like C3D10.
# Seen:  C3D4H fails: its table names a cell "tetra4", which meshio does not have.
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

path = Path(sys.argv[1])
NODES = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n"
seen = {}
for kind in ("C3D4", "C3D4H"):
    path.write_text(f"*HEADING\na\n{NODES}*ELEMENT, TYPE={kind}, ELSET=A\n1, 1, 2, 3, 4\n")
    try:
        seen[kind] = [each.type for each in meshio.read(path).cells]
    except Exception as error:
        seen[kind] = f"{type(error).__name__}: {error}"
    print(kind, seen[kind])
sys.exit(not (seen["C3D4"] == ["tetra"] and seen["C3D4H"] != ["tetra"]))
PYTHON
