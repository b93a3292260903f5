#!/bin/sh
# mne 1.13.2: a valid EDF+ recording of a force (20 Hz, 0 or 20 N: a weight laid on and taken off) beside a
# muscle's signal (1000 Hz), read by `read_raw_edf`; edfio 0.4.18 reads the same.
# Guess: the force is brought to 1000 Hz, as documented, by values between its readings: 0 to 20 N.
# Seen:  -2.8 to 22.8 N: it is resampled by Fourier transform, which swings about every step. The peak force is
#        14 % too large, and the scale pulls before anything touches it. Alone (`include="force"`), and by
#        edfio, it is 0 to 20 N.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q mne==1.13.2 edfio==0.4.18 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import edfio
import mne
import numpy as np

file = Path(sys.argv[1]) / "hold.edf"
time = np.arange(0, 20, 1 / 20)
force = np.where((time > 5) & (time < 15), 20.0, 0.0)
muscle = np.random.default_rng(7).normal(0, 50, 20_000)
edfio.Edf([
    edfio.EdfSignal(force, 20, label="force", physical_dimension="N", physical_range=(0, 50)),
    edfio.EdfSignal(muscle, 1000, label="EMG", physical_dimension="uV", physical_range=(-500, 500)),
]).write(file)

read = {
    "mne": mne.io.read_raw_edf(file, preload=True, verbose="error").get_data("force"),
    "mne, alone": mne.io.read_raw_edf(file, include="force", preload=True, verbose="error").get_data(),
    "edfio": edfio.read_edf(file).get_signal("force").data,
}
seen = {name: (round(float(x.min()), 1) + 0.0, round(float(x.max()), 1)) for name, x in read.items()}
for name, (low, high) in seen.items():
    print(name, "force", low, "to", high, "N")
sys.exit(seen != {"mne": (-2.8, 22.8), "mne, alone": (0, 20), "edfio": (0, 20)})
PYTHON
