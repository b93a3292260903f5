#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4) and surface-distance 0.1: the average distance of two balls about one centre,
# radii 15 and 17 mm, voxels of 1 mm.
# Guess: HausdorffDistanceImageFilter's GetAverageHausdorffDistance is the average distance of the surfaces,
#        2 mm.
# Seen:  0.2 mm. It averages over all voxels of a mask, and those inside the other count as 0: the larger a
#        limb, the better the number. Its largest distance is that of the surfaces.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 surface-distance==0.1 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import SimpleITK as sitk
import surface_distance

k, j, i = np.indices((50, 50, 50)) - 25
away = np.sqrt(i**2 + j**2 + k**2)
small, large = away < 15, away < 17
by_itk = sitk.HausdorffDistanceImageFilter()
by_itk.Execute(*(sitk.GetImageFromArray(each.astype(np.uint8)) for each in (small, large)))
average, largest = by_itk.GetAverageHausdorffDistance(), by_itk.GetHausdorffDistance()
surfaces = surface_distance.compute_surface_distances(small, large, (1.0, 1.0, 1.0))
there, back = surface_distance.compute_average_surface_distance(surfaces)
print(f"ITK: average {average:.2f} mm, largest {largest:.1f} mm")
print(f"surface-distance: average {there:.2f} and {back:.2f} mm")
sys.exit(not (average < 0.3 and 2 < largest < 3 and 1.5 < min(there, back) < max(there, back) < 2.5))
PYTHON
