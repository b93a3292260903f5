#!/bin/sh
# muDIC 0.2.1 (digital image correlation): a speckled sheet of skin, as images made from one, is stretched by
# 10 % along x and then turned by 30 degrees, and another is sheared by 0.3.
# Guess: `green_strain`, described as (F^T F - I)/2, does not know of turns: xx 0.105 and nothing else before
#        and after; of the shear xx 0, yy 0.045.
# Seen:  turned, it has xx 0.079, yy 0.026, xy 0.045, and of the shear xx 0.045, yy 0: computed is (F F^T - I)/2,
#        whose axes turn along with the sheet. `F` is right. `eng_strain` and `true_strain` are made from it.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --no-deps muDIC==0.2.1 2>/dev/null
"$folder/venv/bin/pip" install -q numpy==1.26.4 scipy==1.12.0 matplotlib==3.8.4 scikit-image==0.22.0 \
  natsort==8.4.0 dill==0.4.1 numba==0.60.0 2>/dev/null
export MPLBACKEND=Agg MPLCONFIGDIR="$folder" NUMBA_CACHE_DIR="$folder"
"$folder/venv/bin/python" -W ignore - 2>/dev/null <<'PYTHON'
import sys
from types import SimpleNamespace

import numpy as np
from scipy import ndimage

# its virtual laboratory alone needs this package, which has to be compiled
sys.modules["noise"] = SimpleNamespace(pnoise2=None, snoise2=None)
import muDIC

SIZE = 200
MIDDLE = (SIZE - 1) / 2
speckles = ndimage.gaussian_filter(np.random.default_rng(7).normal(size=(SIZE, SIZE)), 2.0)
speckles = (speckles - speckles.min()) / np.ptp(speckles) * 255


def image(gradient):
    """The sheet after the deformation gradient, about the middle; x is the column, y the row."""
    y, x = np.indices(speckles.shape) - MIDDLE
    x, y = np.linalg.inv(gradient) @ np.stack([x.ravel(), y.ravel()]) + MIDDLE
    return ndimage.map_coordinates(speckles, [y, x], order=3, mode="reflect").reshape(speckles.shape)


def turn(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


stretches = [np.diag([1 + 0.02 * k, 1]) for k in range(1, 6)]
CASES = {"stretched": stretches,
         "stretched and turned": stretches + [turn(each) @ stretches[-1] for each in range(2, 32, 2)],
         "sheared": [np.array([[1, 0.05 * k], [0, 1]]) for k in range(1, 7)]}
seen = {}
for name, gradients in CASES.items():
    images = muDIC.image_stack_from_list([image(each) for each in [np.eye(2), *gradients]])
    mesh = muDIC.Mesher(deg_n=1, deg_e=1, type="q4").mesh(
        images, Xc1=60, Xc2=140, Yc1=60, Yc2=140, n_ely=4, n_elx=4, GUI=False)
    task = muDIC.DICInput(mesh, images)
    task.maxit, task.tol = 100, 1e-6
    fields = muDIC.Fields(muDIC.DICAnalysis(task).run())
    gradient, strain = (each[0, ..., -1].reshape(2, 2, -1).mean(axis=-1)
                        for each in (fields.F(), fields.green_strain()))
    assert np.allclose(gradient, gradients[-1], atol=2e-3)
    true = (gradients[-1].T @ gradients[-1] - np.eye(2)) / 2
    seen[name], right = [[round(float(each[i, j]), 3) + 0.0 for i, j in ((0, 0), (1, 1), (0, 1))]
                         for each in (strain, true)]
    print(f"{name}: Green strain xx, yy, xy", *seen[name], "; true", *right)
expected = {"stretched": [0.105, 0, 0], "stretched and turned": [0.079, 0.026, 0.045],
            "sheared": [0.045, 0, 0.15]}
sys.exit(not all(np.allclose(seen[name], expected[name], atol=0.004) for name in CASES))
PYTHON
