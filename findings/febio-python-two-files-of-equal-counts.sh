#!/bin/sh
# febio-python 0.2.1: two valid FEBio 4.0 files with the same numbers of nodes and elements, as of one mesh
# laid on two limbs, read one after the other.
# Guess: each gives its own nodes.
# Seen:  the second gives those of the first, and no word is said: what was read is kept under the model's
#        summary, which tells counts only. In a series of limbs of one mesh all are the first.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q febio-python==0.2.1 numpy==2.4.6 tqdm==4.67.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

from febio_python.feb import Feb

TEXT = """<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0">
<Module type="solid"/>
<Material><material id="1" name="fat" type="neo-Hookean"><E>1</E><v>0.3</v></material></Material>
<Mesh>
<Nodes name="limb">
<node id="1">0,0,0</node><node id="2">{},0,0</node><node id="3">0,1,0</node><node id="4">0,0,1</node>
</Nodes>
<Elements type="tet4" name="limb"><elem id="1">1,2,3,4</elem></Elements>
</Mesh>
<MeshDomains><SolidDomain name="limb" mat="fat"/></MeshDomains>
</febio_spec>
"""
seen = {}
for name, wide in (("first", 1), ("second", 7)):
    path = Path(sys.argv[1]) / f"{name}.feb"
    path.write_text(TEXT.format(wide))
    seen[name] = float(Feb(filepath=str(path)).get_nodes()[0].coordinates[:, 0].max())
    print(f"{name}: {seen[name]:g} mm wide, {wide} in the file")
sys.exit(seen != {"first": 1.0, "second": 1.0})
PYTHON
