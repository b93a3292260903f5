#!/bin/sh
# krippendorff 0.9.0 and irrCAC 0.4.4: Krippendorff's alpha of ten people, graded from 1 to 5 by three raters (two
# grades are missing), for each level of measurement.
# Guess: one number at each level, as both give the coefficient under this name.
# Seen:  nominal 0.675, interval 0.862 and ratio 0.745 by both; ordinal 0.805 and 0.833: krippendorff weighs two
#        grades by how many were given between them (Krippendorff's ordinal metric), irrCAC by how many grades
#        there are (Gwet's ordinal weights). Grades are ordinal, and a study that wants 0.8 passes or fails by it.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q krippendorff==0.9.0 irrCAC==0.4.4 pandas==2.3.3 numpy==1.26.4 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import krippendorff
import numpy as np
import pandas as pd
from irrCAC.raw import CAC

GRADES = np.array([[1, 2, 3, 3, 2, 1, 4, 1, 2, np.nan],
                   [1, 2, 3, 3, 2, 2, 4, 1, 2, 5],
                   [np.nan, 3, 3, 3, 2, 3, 4, 2, 2, 5]])  # raters by people
seen = {}
for level, weights in {"nominal": "identity", "ordinal": "ordinal", "interval": "quadratic", "ratio": "ratio"}.items():
    own = krippendorff.alpha(GRADES, level_of_measurement=level)
    other = CAC(pd.DataFrame(GRADES.T), weights=weights).krippendorff()["est"]["coefficient_value"]
    seen[level] = [round(float(each), 3) for each in (own, other)]
    print(f"{level}: krippendorff {seen[level][0]}, irrCAC {seen[level][1]}")
sys.exit(seen != {"nominal": [0.675, 0.675], "ordinal": [0.805, 0.833], "interval": [0.862, 0.862],
                  "ratio": [0.745, 0.745]})
PYTHON
