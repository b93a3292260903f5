#!/bin/sh
# meshio 5.3.5 and pyNastran 1.3.4: a valid Nastran bulk data file whose GRID points name a coordinate system
# (third field, CP) that CORD2R puts 100 mm up the z axis.
# Guess: both return the places in the basic system, where the four corners are 1 mm apart.
# Seen:  meshio passes over CP and takes local coordinates for basic ones, without a word: three corners lie
#        at z = 0, the fourth, which is stated in the basic system, at z = 101.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 pyNastran==1.3.4 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/a.bdf" <<'PYTHON'
import sys
from pathlib import Path

import meshio
from pyNastran.bdf.bdf import BDF

TEXT = """CEND
BEGIN BULK
CORD2R,1,0,0.,0.,100.,0.,0.,101.
,1.,0.,100.
GRID,1,1,0.,0.,0.
GRID,2,1,1.,0.,0.
GRID,3,1,0.,1.,0.
GRID,4,,0.,0.,101.
CTETRA,1,1,1,2,3,4
PSOLID,1,1
MAT1,1,1.,,.3
ENDDATA
"""
path = Path(sys.argv[1])
path.write_text(TEXT)
by_meshio = meshio.read(path).points[:, 2].tolist()
model = BDF(debug=None)
model.read_bdf(path)
by_pynastran = [float(model.nodes[k].get_position()[2]) for k in (1, 2, 3, 4)]
print("z, pyNastran:", by_pynastran)
print("z, meshio:   ", by_meshio)
sys.exit((by_pynastran, by_meshio) != ([100.0, 100.0, 100.0, 101.0], [0.0, 0.0, 0.0, 101.0]))
PYTHON
