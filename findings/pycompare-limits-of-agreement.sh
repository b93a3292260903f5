#!/bin/sh
# pyCompare 1.5.4 and bland-altman 0.1.4: limits of agreement of eight and of five people's shear-wave
# speeds by two observers.
# Guess: mean +- 1.96 standard deviations of the differences, estimated with n - 1 (Bland and Altman 1986
#        and 1999, which pyCompare cites).
# Seen:  both divide by n: their limits are 6.5 % closer together with eight people, 10.6 % with five, which
#        looks like better agreement. Neither says so.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyCompare==1.5.4 bland-altman==0.1.4 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import matplotlib.pyplot as plt
import numpy as np
import pyCompare
from bland_altman import bland_altman_plot

FIRST = [2.1, 2.4, 1.9, 3.0, 2.6, 2.2, 2.8, 2.0]  # m/s
SECOND = [2.0, 2.6, 2.0, 2.7, 2.7, 2.0, 2.9, 2.2]


def width(axes):
    """Distance of the outermost horizontal lines."""
    heights = [float(line.get_ydata()[0]) for line in axes.lines if len(set(line.get_ydata())) == 1]
    return max(heights) - min(heights)


def drawn_by(draw):
    _, axes = plt.subplots()
    draw(axes)
    return width(plt.gca())


seen = {}
for n in (8, 5):
    a, b = FIRST[:n], SECOND[:n]
    wanted = 2 * 1.96 * float(np.std(np.subtract(a, b), ddof=1))
    compare = drawn_by(lambda axes, a=a, b=b: pyCompare.blandAltman(a, b, confidenceInterval=None, ax=axes))
    plt.show = lambda: None
    other = drawn_by(lambda axes, a=a, b=b: bland_altman_plot(a, b))
    seen[n] = [round(100 * (each / wanted - 1), 1) for each in (compare, other)]
    print(n, "people: width", round(wanted, 3), "m/s; pyCompare and bland-altman", *seen[n], "%")
sys.exit(seen != {8: [-6.5, -6.5], 5: [-10.6, -10.6]})
PYTHON
