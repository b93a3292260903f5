#!/bin/sh
# pyxdf 1.16.8: a valid XDF recording (Lab Streaming Layer) of a force and a depth, both at 100 Hz for 10 s;
# the force's connection was lost for 0.9 s, and its time stamps say so.
# Guess: each sample comes back at its own time, but for a jitter of milliseconds, which `load_xdf` removes by
#        default where a stream is regularly sampled.
# Seen:  the times of the force are wrong by -0.48 to +0.42 s: the samples before and after the pause are laid on
#        one straight line. A probe that sinks at 2 mm/s has a force from a millimetre deeper or shallower. The
#        log tells of another rate (87 Hz), not of times; breaks below 1 s count as jitter. Without
#        `dejitter_timestamps` they are right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyxdf==1.16.8 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import struct
import sys
from pathlib import Path

import numpy as np
import pyxdf

file = Path(sys.argv[1]) / "press.xdf"
HEADER = ("<?xml version='1.0'?><info><name>{}</name><type>sensor</type><channel_count>1</channel_count>"
          "<nominal_srate>100</nominal_srate><channel_format>double64</channel_format></info>")
FOOTER = ("<?xml version='1.0'?><info><first_timestamp>{}</first_timestamp><last_timestamp>{}</last_timestamp>"
          "<sample_count>{}</sample_count></info>")


def chunk(tag, content):
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content


time = np.arange(0, 10, 0.01)
streams = {"force": time[(time < 4) | (time >= 4.9)], "depth": time}
content = b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
for number, (name, stamps) in enumerate(streams.items(), 1):
    own = struct.pack("<I", number)
    samples = b"".join(b"\x08" + struct.pack("<dd", each, each) for each in stamps)  # the value tells the time
    content += chunk(2, own + HEADER.format(name).encode())
    content += chunk(3, own + b"\x04" + struct.pack("<I", len(stamps)) + samples)
    content += chunk(6, own + FOOTER.format(stamps[0], stamps[-1], len(stamps)).encode())
file.write_bytes(content)

seen = {}
for dejitter in (True, False):
    for stream in pyxdf.load_xdf(str(file), dejitter_timestamps=dejitter)[0]:
        off = stream["time_stamps"] - stream["time_series"][:, 0]
        name = stream["info"]["name"][0], dejitter
        seen[name] = round(float(off.min()), 2) + 0.0, round(float(off.max()), 2) + 0.0
        print(*name, "times are off by", *seen[name], "s")
sys.exit(seen != {("force", True): (-0.48, 0.42), ("depth", True): (0, 0), ("force", False): (0, 0),
                  ("depth", False): (0, 0)})
PYTHON
