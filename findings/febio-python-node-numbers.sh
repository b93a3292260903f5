#!/bin/sh
# febio-python 0.2.1: a valid FEBio 4.0 file whose nodes are numbered 11, 12, 13 and 20, as of a part taken
# out of a larger mesh; elements and sets name nodes by these numbers.
# Guess: the nodes come with their numbers, so that an element finds its corners.
# Seen:  the numbers of the nodes are passed over: they get 0 to 3, while the element keeps 10, 11, 12, 19
#        (its numbers less one), and so do sets. Taken together, an element has no corners here, and others'
#        where there are more nodes: another limb. No word is said.
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
<node id="{}">0,0,0</node><node id="{}">1,0,0</node><node id="{}">0,1,0</node><node id="{}">0,0,1</node>
</Nodes>
<Elements type="tet4" name="limb"><elem id="1">{},{},{},{}</elem></Elements>
</Mesh>
<MeshDomains><SolidDomain name="limb" mat="fat"/></MeshDomains>
</febio_spec>
"""
NUMBERS = (11, 12, 13, 20)
path = Path(sys.argv[1]) / "a.feb"
path.write_text(TEXT.format(*NUMBERS, *NUMBERS))
model = Feb(filepath=str(path))
nodes, corners = model.get_nodes()[0].ids.tolist(), model.get_elements()[0].connectivity[0].tolist()
print("nodes:", nodes, " corners of the element:", corners)
sys.exit((nodes, corners) != ([0, 1, 2, 3], [10, 11, 12, 19]))
PYTHON
