#!/bin/sh
# SALib 1.6.0: the sum of two normally distributed parameters, given as the package wants them, `bounds` of
# mean and standard deviation: 5 +- 4 and 20 +- 1. The first makes 94 % of the variance.
# Guess: `dgsm` is the upper bound of the total index that its sources give (Sobol and Kucherenko 2009 and
#        2010), of a normal parameter its mean squared derivative times its variance over the output's: here
#        0.94 and 0.06.
# Seen:  0.006 and 2.2: mean and standard deviation are taken as the ends of a range. The bound is below the
#        total index that the package's own `sobol` finds, the order of the parameters is reversed, and moving
#        both means by 50 makes it 16 and 28. Of uniform parameters it is right, 1.2 times the index. No word
#        is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SALib==1.6.0 numpy==2.2.0 scipy==1.17.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from SALib.analyze import dgsm
from SALib.analyze import sobol as sobol_indices
from SALib.sample import finite_diff
from SALib.sample import sobol

CASES = {"normal": ("norm", [[5, 4], [20, 1]]), "normal, means 50 more": ("norm", [[55, 4], [70, 1]]),
         "uniform": ("unif", [[0, 4], [0, 1]])}
seen = {}
for name, (kind, bounds) in CASES.items():
    problem = {"num_vars": 2, "names": ["muscle", "skin"], "bounds": bounds, "dists": [kind] * 2}
    values = finite_diff.sample(problem, 2000, seed=1)
    bound = np.asarray(dgsm.analyze(problem, values, values.sum(axis=1), seed=1)["dgsm"], float)
    total = sobol_indices.analyze(problem, sobol.sample(problem, 2048, seed=1).sum(axis=1), seed=1)["ST"]
    seen[name] = [round(float(each), 2) for each in (*bound, *total)]
    print(f"{name}: bounds {bound[0]:.3f} and {bound[1]:.3f}, total indices {total[0]:.2f} and {total[1]:.2f}")
first, moved, uniform = seen.values()
sys.exit(not (first[0] < 0.02 and 1.8 < first[1] < 2.6 and moved[0] > 10 and moved[1] > 10
              and first[2:] == moved[2:] == uniform[2:] == [0.94, 0.06]
              and 1.1 < uniform[0] / 0.94 < 1.35))
PYTHON
