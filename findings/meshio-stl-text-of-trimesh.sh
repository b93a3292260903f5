#!/bin/sh
# meshio 5.3.5: text STL as trimesh 5.2.0 writes it, with an empty line before `endsolid`.
# Guess: the empty line is passed over, and the 12 triangles of a box are read.
# Seen:  ValueError, "cannot reshape array"; without the empty line the file is read.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 trimesh==5.2.0 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/a.stl" <<'PYTHON'
import sys
from pathlib import Path

import meshio
import trimesh

path = Path(sys.argv[1])
trimesh.creation.box().export(path, file_type="stl_ascii")
try:
    meshio.read(path)
    refused = False
except ValueError as error:
    print("as trimesh writes it:", error)
    refused = "cannot reshape" in str(error)
path.write_text(path.read_text().replace("\n\n", "\n"))
n = len(meshio.read(path).cells[0].data)
print("triangles without the empty line:", n)
sys.exit(not (refused and n == 12))
PYTHON
