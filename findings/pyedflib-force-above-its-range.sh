#!/bin/sh
# pyedflib 0.1.42: a force that rises to 300 N and falls again, written to EDF+ by EdfWriter with the sensor's
# range, 0 to 250 N, as physical minimum and maximum.
# Guess: a refusal, as by pyedflib.highlevel of the same, or a word, as of a range with too many digits.
# Seen:  neither: what is above is written as 250. Read again, the largest force is 250 N, and a sixth of the
#        press is a hold at it. A record whose range was stated by the sensor's data sheet loses its peaks.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyedflib==0.1.42 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
import warnings
from pathlib import Path

import numpy as np
import pyedflib
from pyedflib import highlevel

folder = Path(sys.argv[1])
force = np.concatenate([np.linspace(0, 300, 1000), np.linspace(300, 0, 1000)])
header = {"label": "force", "dimension": "N", "sample_frequency": 1000, "physical_min": 0.0,
          "physical_max": 250.0, "digital_min": -32768, "digital_max": 32767, "transducer": "", "prefilter": ""}
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    writer = pyedflib.EdfWriter(str(folder / "a.edf"), 1, file_type=pyedflib.FILETYPE_EDFPLUS)
    writer.setSignalHeader(0, header)
    writer.writeSamples([force])
    writer.close()
again = pyedflib.EdfReader(str(folder / "a.edf")).readSignal(0)
try:
    highlevel.write_edf(str(folder / "b.edf"), [force], [header])
    refused = False
except AssertionError:
    refused = True
share = round(float(np.mean(again > 249.9)), 2)
print("largest force", force.max(), "N, read again", again.max(), "N, over", share, "of the record; warnings",
      len(told), "; refused by highlevel", refused)
sys.exit((round(float(again.max())), share, len(told), refused) != (250, 0.17, 0, True))
PYTHON
