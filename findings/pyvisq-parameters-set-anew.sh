#!/bin/sh
# pyvisq 1.2.2 (viscoelastic models): a standard linear solid (`SLS`) with springs of 1, whose `params` are set
# anew, to springs of 5, as a fit does at every step; and a new solid of 5.
# Guess: both relax alike, and creep alike: `params` can be set, and is checked when it is.
# Seen:  the relaxation modulus stays that of springs of 1, 1.14 for 5.00 after 2 s: the parts were made of the
#        first parameters. The creep compliance is the new one, 0.199, but at a time that was asked for before
#        it is the old one, 0.697 for 0.192 after 1 s: results are kept by time only. A fit sees no change, and
#        ends where it began. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvisq==1.2.2 mpmath==1.3.0 pymittagleffler==0.3.0 numpy==2.4.6 scipy==1.17.1 \
    matplotlib==3.11.2 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

from pyvisq.models.elements import DashpotParams, SpringParams
from pyvisq.models.zener import SLS, SLSParams


def parameters(stiffness):
    return SLSParams(DashpotParams(1.0), SpringParams(stiffness), SpringParams(stiffness))


solid, new = SLS(parameters(1.0)), SLS(parameters(5.0))
solid.G(1.0), solid.J(1.0)
solid.params = parameters(5.0)
seen = {}
for time in (1.0, 2.0):
    seen[time] = [round(float(each), 3) for each in (solid.G(time), new.G(time), solid.J(time), new.J(time))]
    print(f"after {time} s: G {seen[time][0]} (new solid {seen[time][1]}), J {seen[time][2]} ({seen[time][3]})")
sys.exit(seen != {1.0: [1.368, 5.034, 0.697, 0.192], 2.0: [1.135, 5.0, 0.199, 0.199]})
PYTHON
