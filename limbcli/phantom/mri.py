"""The anatomy as a T1-weighted MR image with partial volume, bias field and Rician noise.

Fat, marrow and oil are bright, cortex and flowing blood dark. A voxel's signal is the mean over the tissues
in it (supersampled where the tissue changes), multiplied by a smooth coil sensitivity. Noise is added to both
quadrature channels before the magnitude is taken (Gudbjartsson & Patz 1995, Magn Reson Med 34:910).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limbcli.model import Array, IntArray
from limbcli.phantom.anatomy import Anatomy, Tissue
from limbcli.progress import SILENT, Progress

# Signal in arbitrary units, in the order of `Tissue`.
SIGNAL = {
    Tissue.AIR: 0.0, Tissue.SKIN: 420.0, Tissue.FAT: 980.0, Tissue.MUSCLE: 360.0, Tissue.CORTEX: 45.0,
    Tissue.MARROW: 900.0, Tissue.VESSEL: 110.0, Tissue.MARKER: 1150.0,
}  # fmt: skip
NOISE = 14.0
TEXTURE = 0.04
BIAS = 0.12


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Voxel centres of an image in the patient frame (LPS, mm).

    origin : (3,) centre of voxel (0, 0, 0)
    axes : (3, 3) rows are the unit directions of the column index i, the row index j and the slice index k
    spacing : (3,)
    shape : (3,) counts
    """

    origin: Array
    axes: Array
    spacing: Array
    shape: tuple[int, int, int]

    def points(self, index: Array) -> Array:
        """Fractional indices (n, 3) (i, j, k) -> patient positions (n, 3)."""
        return self.origin + (index * self.spacing) @ self.axes

    @property
    def patient_from_index(self) -> Array:
        """(4, 4) homogeneous transform."""
        matrix = np.eye(4)
        matrix[:3, :3] = (self.axes * self.spacing[:, None]).T
        matrix[:3, 3] = self.origin
        return matrix

    def beyond_last_slice(self, points: Array) -> Array:
        """Distance of patient positions beyond the outer face of the last slice (n,)."""
        last = (self.shape[2] - 0.5) * self.spacing[2]
        return (points - self.origin) @ self.axes[2] - last


@dataclass(frozen=True, eq=False)
class SimulatedVolume:
    """signal (ni, nj, nk) float; fractions of all tissues in each voxel (n_tissues, ni, nj, nk)."""

    grid: VoxelGrid
    signal: Array
    fractions: Array

    @property
    def labels(self) -> IntArray:
        """Label of the majority tissue of each voxel: 0 air, 1 soft tissue, 2 bone, 3 marker."""
        f = self.fractions
        bone = f[Tissue.CORTEX] + f[Tissue.MARROW]
        marker = f[Tissue.MARKER]
        soft = f[Tissue.SKIN] + f[Tissue.FAT] + f[Tissue.MUSCLE] + f[Tissue.VESSEL]
        return np.argmax(np.stack([f[Tissue.AIR], soft, bone, marker]), axis=0).astype(np.int64)


def tissue_fractions(
    anatomy: Anatomy,
    grid: VoxelGrid,
    limb_from_patient: Array,
    *,
    supersampling: tuple[int, int, int] = (3, 3, 4),
    progress: Progress = SILENT,
) -> Array:
    """Fraction of each tissue in each voxel, (n_tissues, ni, nj, nk).

    A voxel whose neighbours all contain the same tissue is classified by one sample; the others are the mean
    over supersampling[0] * [1] * [2] samples.
    """

    def classify(index: Array) -> IntArray:
        limb = grid.points(index) @ limb_from_patient[:3, :3].T + limb_from_patient[:3, 3]
        return anatomy.classify(limb)

    index = np.indices(grid.shape).reshape(3, -1).T.astype(float)
    center = classify(index).reshape(grid.shape)
    n_tissues = len(Tissue)
    fractions = np.zeros((n_tissues, center.size), dtype=np.float32)
    fractions[center.ravel(), np.arange(center.size)] = 1.0
    mixed = ndimage.maximum_filter(center, 3) != ndimage.minimum_filter(center, 3)
    offsets = _offsets(supersampling)
    todo = np.flatnonzero(mixed.ravel())
    chunks = np.array_split(todo, max(1, len(todo) * len(offsets) // 1_000_000))
    for done, chunk in enumerate(chunks, start=1):
        samples = (index[chunk][:, None, :] + offsets).reshape(-1, 3)
        tissue = classify(samples).reshape(len(chunk), len(offsets))
        for each in range(n_tissues):
            fractions[each, chunk] = (tissue == each).mean(axis=1)
        progress.event("task", name="partial volume", done=done, total=len(chunks))
    return fractions.reshape(n_tissues, *grid.shape).astype(float)


def _offsets(counts: tuple[int, int, int]) -> Array:
    axes = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def acquire(fractions: Array, grid: VoxelGrid, *, rng: np.random.Generator) -> SimulatedVolume:
    """Magnitude image of the tissue fractions."""
    levels = np.array([SIGNAL[each] for each in Tissue])
    clean = np.tensordot(levels, fractions, axes=1)
    texture = ndimage.gaussian_filter(rng.standard_normal(grid.shape), 2.0)
    clean *= 1 + TEXTURE * texture / texture.std()
    # smooth coil sensitivity around 1: a random quadratic, +-`BIAS` over the image
    i, j, k = np.meshgrid(*(np.linspace(-1, 1, n) for n in grid.shape), indexing="ij")
    terms = [i, j, k, i * j, j * k, i * k, i**2 - 1 / 3, j**2 - 1 / 3, k**2 - 1 / 3]
    field = sum(weight * term for weight, term in zip(rng.uniform(-1, 1, len(terms)), terms, strict=True))
    clean *= np.asarray(1 + BIAS * field / np.abs(field).max())
    real = clean + NOISE * rng.standard_normal(grid.shape)
    imaginary = NOISE * rng.standard_normal(grid.shape)
    return SimulatedVolume(grid=grid, signal=np.hypot(real, imaginary), fractions=fractions)
