"""Convert masks to closed, smooth surfaces; read and write surfaces.

Marching cubes is applied to the smoothed distance field of a mask, so that voxel steps disappear with hardly
any shrinkage; where the limb leaves the image, the surface is closed by the flat outer face of the image.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage import measure

from limbcli.errors import CaseError, MeshError
from limbcli.files.atomic import atomic_file
from limbcli.imaging.signed_distance import box_around, largest, signed_distance
from limbcli.imaging.volume import Volume
from limbcli.meshing import surfaces
from limbcli.meshing.meshlab import open_pymeshlab
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, IntArray
from limbcli.numbers.distinct_rows import distinct_rows

SKIN_EDGE, BONE_EDGE = 2.0, 1.5  # mm, edge lengths of the triangles, as usual
SMOOTH = 0.7  # mm: standard deviation of the Gaussian smoothing of the distance field
_SHARE_OF_SLICE = 0.45  # ... or this fraction of the slice spacing, if that is more


def surface_of(mask: Volume, *, edge: float, smooth: float = SMOOTH, where: str = "surface") -> Triangles:
    """The closed surface of a mask.

    mask : Volume of bool
    edge : about the length of a triangle's edge, mm
    smooth : standard deviation of the smoothing, mm

    Returns triangles in patient LPS, watertight and two-manifold

    Raises MeshError if the mask is empty, so thin that smoothing leaves nothing, or no closed surface comes
    out.

    >>> grid = np.indices((24, 24, 24)) - 11.5
    >>> ball = Volume((grid**2).sum(axis=0) < 81, np.diag([1.0, 1.0, 1.0, 1.0]))
    >>> surface = surface_of(ball, edge=1.5)
    >>> surface.is_closed, abs(surface.volume / (4 / 3 * np.pi * 9**3) - 1) < 0.02
    (True, True)
    """
    if not mask.values.any():
        raise MeshError("the mask is empty", where=where, fix="check the label map")
    raw = _marching_cubes(mask, edge=0.8 * edge, smooth=smooth, where=where)
    surface = remeshed(raw, edge=edge)
    if not (surface.is_closed and surface.volume > 0):
        surface = raw
    if not (surface.is_closed and surface.volume > 0):
        raise MeshError(
            "the surface of the label map is not closed",
            where=where,
            fix="smooth the label map (--smooth) or repair it in 3D Slicer",
        )
    return surface


def _marching_cubes(mask: Volume, *, edge: float, smooth: float, where: str) -> Triangles:
    spacing = mask.spacing
    window = box_around(mask.values, np.ceil(6.0 / spacing))
    field = signed_distance(mask.values[window], spacing)
    sigma = np.maximum(smooth, _SHARE_OF_SLICE * spacing) / spacing if smooth > 0 else 0.0
    field = ndimage.gaussian_filter(field, sigma, mode="nearest")
    axes = [_grid(n, edge / h, each) for n, h, each in zip(mask.shape, spacing, window, strict=True)]
    start = np.array([each.start for each in window], float)
    grid = np.meshgrid(*(at - first for at, first in zip(axes, start, strict=True)), indexing="ij")
    values = ndimage.map_coordinates(field, grid, order=3, mode="nearest", output=np.float32)
    for axis, (n, at) in enumerate(zip(mask.shape, axes, strict=True)):
        depth = (np.minimum(at + 0.5, n - 0.5 - at) * spacing[axis]).astype(np.float32)
        values = np.minimum(values, depth.reshape([-1 if each == axis else 1 for each in range(3)]))
    if values.max() <= 0:
        raise MeshError(
            f"smoothing by {smooth:g} mm leaves nothing of what is so thin",
            where=where,
            fix="smooth less (--smooth), or mend the label map there",
        )
    values = _largest_part(values)
    points, triangles, *_ = measure.marching_cubes(values, 0.0, gradient_direction="ascent")
    index = np.stack([np.interp(points[:, n], np.arange(len(axes[n])), axes[n]) for n in range(3)], axis=1)
    surface = Triangles(mask.to_patient(index), triangles.astype(np.int64))
    return surface if surface.volume > 0 else surface.flipped()


def _grid(n: int, step: float, window: slice) -> Array:
    """Grid positions along an axis of n voxels, about `step` voxels apart, over a slightly enlarged window.

    The image's two outer faces lie half way between two positions, so that a flat cut there has regular
    triangles.

    >>> _grid(10, 2.4, slice(0, 10))
    array([-1.75,  0.75,  3.25,  5.75,  8.25, 10.75])
    """
    exact = n / max(1, round(n / step))
    first = int(np.floor(window.start / exact)) - 1
    last = int(np.ceil(window.stop / exact)) + 1
    return np.asarray(-0.5 + (np.arange(first, last) + 0.5) * exact, dtype=np.float64)


def _largest_part(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Remove everything but the largest component of the inside, and fill its holes."""
    tiny = np.float32(1e-3)
    values = np.where(np.abs(values) < tiny, np.copysign(tiny, values), values)
    values = np.where((values > 0) & ~largest(values > 0), -tiny, values)
    holes = ndimage.binary_fill_holes(values > 0) & (values <= 0)
    return np.where(holes, tiny, values)


def remeshed(surface: Triangles, *, edge: float) -> Triangles:
    """Remesh with nearly equilateral triangles of about `edge` mm; sharp edges (over 40 degrees) are kept."""
    pymeshlab = open_pymeshlab()

    meshes = pymeshlab.MeshSet(verbose=False)
    centre = surface.points.mean(axis=0)
    meshes.add_mesh(pymeshlab.Mesh(surface.points - centre, surface.faces.astype(np.int32)))
    meshes.meshing_merge_close_vertices(threshold=pymeshlab.PureValue(1e-3 * edge))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=4, targetlen=pymeshlab.PureValue(edge), featuredeg=40.0, adaptive=False
    )
    meshes.meshing_remove_duplicate_vertices()
    meshes.meshing_remove_null_faces()
    meshes.meshing_repair_non_manifold_edges()
    meshes.meshing_remove_unreferenced_vertices()
    mesh = meshes.current_mesh()
    triangles = np.asarray(mesh.face_matrix(), dtype=np.int64)
    return Triangles(np.asarray(mesh.vertex_matrix()) + centre, triangles)


def write_surface(path: Path, surface: Triangles) -> None:
    """Write a binary PLY, mm, patient LPS; the same surface gives the same bytes (no time stamp)."""
    faces = np.zeros(len(surface.faces), [("n", "u1"), ("corners", "<i4", 3)])
    faces["n"], faces["corners"] = 3, surface.faces
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment limbcli: units mm, patient LPS\ncomment SPACE=LPS\n"
        f"element vertex {len(surface.points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with atomic_file(path) as partial:
        content = head.encode() + surface.points.astype("<f4").tobytes() + faces.tobytes()
        partial.write_bytes(content)


def read_surface(path: Path) -> Triangles:
    """Triangles from a file, in patient LPS and mm, coincident points joined; CaseError if there are none."""
    return surfaces.read_surface(path, merge=joined, error_type=CaseError)


def once(triangles: IntArray) -> IntArray:
    """Triangles (n, 3) without duplicates of the same orientation; the first of each is kept.

    >>> once(np.array([[5, 7, 6], [6, 5, 7], [5, 6, 7]])).tolist()
    [[5, 7, 6], [5, 6, 7]]
    """
    first = triangles.argmin(axis=1)[:, None]
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return triangles[np.sort(distinct_rows(turned)[0])]


def joined(surface: Triangles) -> Triangles:
    """Merge coincident points; drop degenerate and duplicate triangles, and unused points."""
    size = np.ptp(surface.points, axis=0).max()
    keys = np.round(surface.points / max(1e-6 * size, 1e-9)).astype(np.int64)
    first, numbers = distinct_rows(keys)
    triangles = numbers[surface.faces]
    whole = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    used, renumbered = np.unique(once(triangles[whole]), return_inverse=True)
    return Triangles(surface.points[first[used]], renumbered.reshape(-1, 3).astype(np.int64))
