#!/bin/sh
# ccx2paraview 3.2.0: a valid CalculiX result file (.frd) of tissue stretched by 10 % in one direction at
# constant volume: strains 0.1, -0.05, -0.05, no shear.
# Guess: the equivalent strain that the converter adds (E_Mises) is von Mises', sqrt(2/3 e':e') of the
#        deviatoric strains: 0.1, as the word says of a uniaxial one.
# Seen:  0.15: the formula is that of the stress, whose factor makes a uniaxial stress its own equivalent, and
#        is half as much again for strains at constant volume. S_Mises beside it is right. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ccx2paraview==3.2.0 vtk==9.6.2 meshio==5.3.5 numpy==2.2.0 2>/dev/null
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import meshio
from ccx2paraview.common import Converter

POINTS = [(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)]


def rows(values):
    return [f" -1{i:10d}" + "".join(f"{each:12.5E}" for each in row) for i, row in enumerate(values, 1)]


def block(name, letter, row):
    """Results of one tensor, the same in all nodes, in CalculiX's order of components."""
    parts = [f" -5  {letter}{axes:8s}    1    4    {axes_at[0]}    {axes_at[1]}"
             for axes, axes_at in (("XX", (1, 1)), ("YY", (2, 2)), ("ZZ", (3, 3)),
                                   ("XY", (1, 2)), ("YZ", (2, 3)), ("ZX", (3, 1)))]
    return ["  100CL  101 1.000000000           4                     0    1           1",
            f" -4  {name:8s}    6    1", *parts, *rows([row] * 4), " -3"]


lines = ["    1C", "    2C" + f"{4:30d}" + f"{1:38d}", *rows(POINTS), " -3",
         "    3C" + f"{1:30d}" + f"{1:38d}", " -1         1    3    0    1",
         " -2" + "".join(f"{i:10d}" for i in range(1, 5)), " -3",
         *block("STRESS", "S", (0.02, 0, 0, 0, 0, 0)), *block("TOSTRAIN", "E", (0.1, -0.05, -0.05, 0, 0, 0)),
         " 9999"]
with open("tissue.frd", "w") as file:
    file.write("\n".join(lines) + "\n")
Converter("tissue.frd", ["vtu"]).run()
found = meshio.read("tissue.vtu").point_data
stress, strain = (float(found[name].ravel()[0]) for name in ("S_Mises", "E_Mises"))
print("stress 0.02 MPa: S_Mises", round(stress, 5), "MPa; strain 0.1: E_Mises", round(strain, 5))
sys.exit([round(stress, 5), round(strain, 5)] != [0.02, 0.15])
PYTHON
