#!/bin/sh
# dipy 1.12.1: muscle fibres of one direction in the patient, (0.6, 0, 0.8) in RAS, as diffusion images with
# FSL's b-vectors (as dcm2niix writes them: along the voxels, x reversed where the affine's determinant is
# positive), stored with x to the left and with x to the right.
# Guess: the tensor's first direction, turned by the image's affine, is the fibres' in both.
# Seen:  (0.6, 0, 0.8) of the image with x to the left, (-0.6, 0, 0.8) of that with x to the right: mirrored, as
#        dipy takes the numbers as they are, and `gradient_table` knows no affine. Fibres that run from the
#        bone to the skin run away from it, at the same angle; the fit is perfect, and no word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q dipy==1.12.1 nibabel==5.4.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import nibabel as nib
import numpy as np
from dipy.core.gradients import gradient_table
from dipy.io.gradients import read_bvals_bvecs
from dipy.reconst.dti import TensorModel

folder, FIBRE = Path(sys.argv[1]), np.array([0.6, 0.0, 0.8])
ways = np.random.default_rng(7).normal(size=(30, 3))
ways /= np.linalg.norm(ways, axis=1)[:, None]
diffusivity = 0.3e-3 * np.eye(3) + 1.4e-3 * np.outer(FIBRE, FIBRE)  # mm2/s
signal = np.r_[1000, 1000 * np.exp(-1000 * np.einsum("ni,ij,nj->n", ways, diffusivity, ways))]

seen = {}
for name, x in (("x to the left", -2.0), ("x to the right", 2.0)):
    affine = np.diag([x, 2.0, 2.0, 1.0])
    along_voxels = ways * np.sign(np.diag(affine)[:3])
    if np.linalg.det(affine) > 0:
        along_voxels = along_voxels * [-1, 1, 1]
    nib.save(nib.Nifti1Image(np.tile(signal, (2, 2, 2, 1)).astype(np.float32), affine), folder / "dwi.nii.gz")
    np.savetxt(folder / "bval", np.r_[0, np.full(30, 1000)][None], fmt="%d")
    np.savetxt(folder / "bvec", np.c_[np.zeros(3), along_voxels.T], fmt="%.6f")

    image = nib.load(folder / "dwi.nii.gz")
    values, vectors = read_bvals_bvecs(str(folder / "bval"), str(folder / "bvec"))
    fit = TensorModel(gradient_table(values, bvecs=vectors)).fit(image.get_fdata())
    found = image.affine[:3, :3] @ fit.evecs[0, 0, 0, :, 0]
    found = found / np.linalg.norm(found) * np.sign(found[2])
    seen[name] = [round(float(each), 2) + 0.0 for each in found]
    print(name, "fibres", seen[name], "anisotropy", round(float(fit.fa[0, 0, 0]), 2))
sys.exit(seen != {"x to the left": [0.6, 0, 0.8], "x to the right": [-0.6, 0, 0.8]})
PYTHON
