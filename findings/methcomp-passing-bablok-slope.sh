#!/bin/sh
# methcomp 1.0.0: Passing-Bablok regression of shear-wave speeds of nineteen people by two scanners, whose
# relation is 1.2 times the first less 0.3 m/s, with little noise (0.02 m/s) and much (0.45 m/s).
# Guess: the shifted median of the slopes of all pairs (Passing and Bablok 1983): 1.19 of both.
# Seen:  with an odd number of slopes the place of the median is divided by the number of negative slopes:
#        of the noisy speeds the slope is -0.27, drawn without a word, of the good ones, which have no
#        negative slope, a ZeroDivisionError.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q methcomp==1.0.0 matplotlib==3.11.2 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys
from itertools import combinations

import matplotlib.pyplot as plt
import methcomp
import numpy as np


def shifted_median(x, y):
    """The slope of Passing and Bablok for an odd number of slopes."""
    slopes = sorted((y[j] - y[i]) / (x[j] - x[i]) for i, j in combinations(range(len(x)), 2))
    assert len(slopes) % 2 == 1
    return float(slopes[(len(slopes) - 1) // 2 + sum(each < -1 for each in slopes)])


def slope_of_methcomp(x, y):
    _, axes = plt.subplots()
    try:
        methcomp.passingbablok(x, y, ax=axes)
    except ZeroDivisionError as error:
        return type(error).__name__
    line = axes.lines[1]
    return round(float(np.diff(line.get_ydata())[0] / np.diff(line.get_xdata())[0]), 2)


first = np.linspace(1.5, 3.5, 19)  # m/s
noise = np.random.default_rng(7).normal(0, 1, 19)
seen = {}
for size in (0.02, 0.45):
    second = 1.2 * first - 0.3 + size * noise
    seen[size] = slope_of_methcomp(first, second), round(shifted_median(first, second), 2)
    print("noise", size, "m/s: methcomp", seen[size][0], "shifted median", seen[size][1])
sys.exit(seen != {0.02: ("ZeroDivisionError", 1.19), 0.45: (-0.27, 1.19)})
PYTHON
