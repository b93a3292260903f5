#!/bin/sh
# chaospy 4.3.21: mean and standard deviation (`E`, `Std`) of a stiffness with a generalised gamma distribution
# (shapes 2 and 1.5, scale 5 kPa) and with Burr's (shapes 6 and 2, scale 10 kPa), and those of 20000 samples.
# Guess: the same: 7.5 +- 3.6 kPa, and Burr's, called type XII, 8.7 +- 2.1 kPa, as by SciPy 1.17.1 (gengamma,
#        burr12).
# Seen:  so are the samples; E and Std have 3.7 +- 2.3 and 12.2 +- 3.5 kPa: in the moments of the first the two
#        shapes are exchanged, and those of the second are another distribution's (Burr's type III). An
#        expansion fitted to such a parameter starts from its moments. Of `Gamma` both agree.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q chaospy==4.3.21 numpy==2.4.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import chaospy
from scipy import stats

CASES = {
    "generalised gamma": (chaospy.GeneralizedGamma(2, 1.5, scale=5), stats.gengamma(2, 1.5, scale=5)),
    "Burr": (chaospy.Burr(6, 2, scale=10), stats.burr12(6, 2, scale=10)),
    "gamma": (chaospy.Gamma(2, scale=5), stats.gamma(2, scale=5)),
}
seen = {}
for name, (own, other) in CASES.items():
    samples = own.sample(20000, rule="halton")
    pairs = (chaospy.E(own), chaospy.Std(own)), (samples.mean(), samples.std()), (other.mean(), other.std())
    seen[name] = [[round(float(each), 1) for each in pair] for pair in pairs]
    print(f"{name}: E and Std {seen[name][0]}, samples {seen[name][1]}, SciPy {seen[name][2]} kPa")
sys.exit(seen != {"generalised gamma": [[3.7, 2.3], [7.5, 3.6], [7.5, 3.6]],
                  "Burr": [[12.2, 3.5], [8.7, 2.1], [8.7, 2.1]],
                  "gamma": [[10.0, 7.1], [10.0, 7.1], [10.0, 7.1]]})
PYTHON
