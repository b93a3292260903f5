#!/bin/sh
# trimesh 5.2.0: a box of 10 inches, `units = "inches"`, saved as 3MF, whose root states the unit of its
# lengths.
# Guess: the file states inches, or holds 254 mm; 3MF has both (3MF Core Specification 1.3, attribute `unit`).
# Seen:  the file states millimeter and holds 10: read again, the box is 25.4 times smaller. trimesh reads the
#        unit of a 3MF in inches, so the unit is lost in writing only.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 lxml networkx 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
import zipfile
from pathlib import Path

import trimesh

folder = Path(sys.argv[1])
box = trimesh.creation.box((10, 10, 10))
box.units = "inches"
box.export(folder / "a.3mf")
with zipfile.ZipFile(folder / "a.3mf") as archive:
    parts = {name: archive.read(name) for name in archive.namelist()}
with zipfile.ZipFile(folder / "inch.3mf", "w") as archive:
    for name, content in parts.items():
        archive.writestr(name, content.replace(b'unit="millimeter"', b'unit="inch"'))
seen = []
for name in ("a.3mf", "inch.3mf"):
    found = trimesh.load(folder / name, force="mesh")
    seen.append((found.units, float(found.extents[0].round(6))))
    print(f"{name}: {seen[-1][1]:g} {seen[-1][0]}")
sys.exit(seen != [("millimeter", 10.0), ("inch", 10.0)])
PYTHON
