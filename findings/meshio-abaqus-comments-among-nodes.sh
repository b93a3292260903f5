#!/bin/sh
# meshio 5.3.5: a valid Abaqus input file with a comment line (**) among its nodes.
# Guess: the comment is passed over; Abaqus allows comments between data lines.
# Seen:  the nodes after the comment are lost without a word: 4 points of 5.
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
path.write_text(f"*HEADING\na\n{NODES}** one more\n5, 1, 1, 1\n*ELEMENT, TYPE=C3D4, ELSET=A\n1, 1, 2, 3, 4\n")
n = len(meshio.read(path).points)
print("points of 5 with a comment among them:", n)
sys.exit(n != 4)
PYTHON
