"""The truth beside the case: label map, closed surfaces and parameters, which the case never reads."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
from skimage import measure

from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, IntArray
from limbcli.phantom.mri import VoxelGrid
from limbcli.phantom.shapes import Implicit, project
from limbcli.phantom.subject import Subject


def closed_surface(shape: Implicit, subject: Subject, *, edge: float) -> Triangles:
    """Triangulate an implicit shape of the limb frame, cut by the outer face of the last slice.

    Marching cubes on a grid of `edge` mm; each vertex that is not on the cut is then projected onto the
    surface, so the vertices are exact for any `edge`.
    """

    def cut(limb: Array) -> Array:
        return subject.grid.beyond_last_slice(subject.to_patient(limb))

    low, high = _bounds(shape, cut)
    counts = tuple(int(each) + 1 for each in np.ceil((high - low) / edge))
    index = np.indices(counts).reshape(3, -1).T
    points = low + index * edge
    values = np.maximum(shape(points), cut(points)).reshape(counts)
    vertices, triangles, *_ = measure.marching_cubes(values, 0.0, gradient_direction="ascent")
    limb = low + vertices * edge
    on_cut = cut(limb) > shape(limb)
    limb[~on_cut] = project(shape, limb[~on_cut])
    over = np.where(on_cut, cut(limb), np.maximum(cut(limb), 0.0))
    normal = subject.limb_from_patient[:3, :3] @ subject.grid.axes[2]
    limb -= over[:, None] * normal
    return Triangles(subject.to_patient(limb), triangles[:, ::-1].astype(np.int64))


def _bounds(shape: Implicit, cut: Implicit) -> tuple[Array, Array]:
    """Bounding box of the shape, from a coarse grid."""
    axes = (np.arange(-75, 76, 5.0), np.arange(-75, 76, 5.0), np.arange(-10, 216, 5.0))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = points[np.maximum(shape(points), cut(points)) < 4.0]
    return inside.min(axis=0) - 5.0, inside.max(axis=0) + 5.0


def surfaces(subject: Subject, *, edge: float = 2.0) -> dict[str, Triangles]:
    """Skin and bones of a subject, by name ("skin", "bone_tibia", "bone_fibula")."""
    found = {"skin": closed_surface(subject.anatomy.skin, subject, edge=edge)}
    for name, bone in subject.anatomy.bones().items():
        found[f"bone_{name}"] = closed_surface(bone, subject, edge=0.75 * edge)
    return found


def write_labels(path: Path, labels: IntArray, grid: VoxelGrid) -> None:
    """Write a label map as NIfTI; its affine is RAS, as the format requires."""
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ grid.patient_from_index
    image = nib.Nifti1Image(labels.astype(np.uint8), affine)
    image.header.set_xyzt_units("mm")
    nib.save(image, path)
