#!/bin/sh
# chaospy 4.3.21: a stiffness of 10 +- 5 kPa cut off at 8 and 12 kPa, by `Trunc(Normal(10, 5), 8, 12)` and by
# `TruncNormal`, 20000 samples each.
# Guess: one distribution: mean 10, standard deviation 1.14 kPa, half of the samples below 10.
# Seen:  of Trunc's samples 28 % are 12 exactly, and the mean is 10.56 kPa: cut off on both sides, the
#        probability is divided by (1 - F(8)) F(12), not by F(12) - F(8). Its E is 10. Cut off on
#        one side only, the samples are right. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q chaospy==4.3.21 numpy==2.2.0 scipy==1.17.1 setuptools==80.9.0 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import chaospy
import numpy as np

FORMS = {"Trunc": chaospy.Trunc(chaospy.Normal(10, 5), 8, 12), "TruncNormal": chaospy.TruncNormal(8, 12, 10, 5),
         "Trunc, one side": chaospy.Trunc(chaospy.Normal(10, 5), 8),
         "TruncNormal, one side": chaospy.TruncNormal(8, 100, 10, 5)}
seen = {}
for name, form in FORMS.items():
    drawn = form.sample(20000, seed=1)
    at_most = float(np.mean(drawn >= 12)) if "side" not in name else 0.0
    seen[name] = [round(float(each), 1) for each in (drawn.mean(), at_most, chaospy.E(form))]
    print(f"{name}: samples' mean {drawn.mean():.2f}, E {float(chaospy.E(form)):.2f}; {at_most:.0%} at 12 kPa")
sys.exit(seen != {"Trunc": [10.6, 0.3, 10.0], "TruncNormal": [10.0, 0.0, 10.0],
                  "Trunc, one side": [12.8, 0.0, 12.8], "TruncNormal, one side": [12.8, 0.0, 12.8]})
PYTHON
