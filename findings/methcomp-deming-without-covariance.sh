#!/bin/sh
# methcomp 1.0.0: Deming regression of shear-wave speeds of ten people by two scanners, and of the same
# speeds with the second scanner's in the opposite order: who was fast is slow now.
# Guess: the slope of Deming (1943), from both variances and the covariance: 1.41 of the pairs, -1.41 of the
#        reversed ones.
# Seen:  1.28 of both. Where the covariance belongs, the variance of the second scanner is taken, so that
#        the line does not depend on which speed belongs to whom, and rises where the pairs fall. No word is
#        said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q methcomp==1.0.0 matplotlib==3.11.2 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import matplotlib.pyplot as plt
import methcomp
import numpy as np


def deming_slope(x, y):
    (xx, xy), (_, yy) = np.cov(x, y)
    return (yy - xx + np.sqrt((yy - xx) ** 2 + 4 * xy**2)) / (2 * xy)


def slope_of_methcomp(x, y):
    _, axes = plt.subplots()
    methcomp.deming(x, y, bootstrap=None, ax=axes)
    line = axes.lines[-1]
    return float(np.diff(line.get_ydata())[0] / np.diff(line.get_xdata())[0])


rng = np.random.default_rng(7)
first = np.linspace(1.5, 3.5, 10)  # m/s
second = 1.4 * first - 0.5 + rng.normal(0, 0.15, 10)
seen = {}
for name, other in (("pairs", second), ("reversed", second[::-1])):
    seen[name] = round(slope_of_methcomp(first, other), 2), round(float(deming_slope(first, other)), 2)
    print(name, "correlation", round(float(np.corrcoef(first, other)[0, 1]), 2), "slopes", *seen[name])
sys.exit(seen != {"pairs": (1.28, 1.41), "reversed": (1.28, -1.41)})
PYTHON
