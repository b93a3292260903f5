#!/bin/sh
# gias3 3.0 (gias3.common 3.0.0, musculoskeletal modelling): the distance of two line segments, as of the axes
# of two bones cut off at their ends: one of 100 mm along x, one that starts 10 mm beside and 40 mm above it and
# rises.
# Guess: `LineSegment3D.calcClosestDistanceToLine`, which takes segments, gives 41.2 mm, the same from both.
# Seen:  10 mm from the first, 41.2 from the second: the other segment is taken for an endless line, as a segment
#        is one of its kind in the package, too. The parameter that comes with it (-40) lies outside of the
#        segment (0 to 60). No word is said; what is written for two segments is never reached.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q gias3.common==3.0.0 numpy==2.2.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

from gias3.common.geoprimitives import LineSegment3D

lying = LineSegment3D([1, 0, 0], [0, 0, 0], 0, 100)
rising = LineSegment3D([0, 0, 1], [50, 10, 40], 0, 60)
seen = {}
for name, (one, other) in {"lying to rising": (lying, rising), "rising to lying": (rising, lying)}.items():
    distance, _, on_other = one.calcClosestDistanceToLine(other)
    seen[name] = [round(float(each), 1) for each in (distance, on_other)]
    print(f"{name}: {seen[name][0]} mm, at {seen[name][1]} on the other, which is from {other.t0} to {other.t1}")
sys.exit(seen != {"lying to rising": [10.0, -40.0], "rising to lying": [41.2, 50.0]})
PYTHON
