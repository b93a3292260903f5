#!/bin/sh
# meshio 5.3.5: valid Abaqus input files of continuum and shell elements, read and written again.
# Guess: the elements are written as they were: C3D8, C3D20, C3D10, S3, or another of full integration.
# Seen:  other elements of the same shape. C3D8 and C3D20 become C3D8RH and C3D20RH (reduced integration,
#        hybrid), C3D10 becomes C3D10MH; the shell S3 becomes R3D3, which is rigid.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import re
import sys
from pathlib import Path

import meshio

CORNERS = [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
folder = Path(sys.argv[1])
seen = {}
for kind, n in (("C3D8", 8), ("C3D20", 20), ("C3D10", 10), ("S3", 3)):
    # places do not matter: only the kind of the element is looked at
    nodes = [f"{k + 1}, {x + k // 8}, {y}, {z}" for k in range(n) for x, y, z in (CORNERS[k % 8],)]
    numbers = [str(k) for k in range(1, n + 1)]
    rows = [", ".join(numbers[k : k + 15]) for k in range(0, n, 15)]
    text = "\n".join(["*HEADING", "a", "*NODE", *nodes, f"*ELEMENT, TYPE={kind}", "1, " + ",\n".join(rows)])
    (folder / "a.inp").write_text(text + "\n")
    meshio.write(folder / "b.inp", meshio.read(folder / "a.inp"))
    seen[kind] = re.search(r"TYPE=(\w+)", (folder / "b.inp").read_text())[1]
    print("read", kind, "written", seen[kind])
sys.exit(seen != {"C3D8": "C3D8RH", "C3D20": "C3D20RH", "C3D10": "C3D10MH", "S3": "R3D3"})
PYTHON
