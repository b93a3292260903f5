"""Quality of tetrahedra: dihedral angles, volumes, Jacobians of straight or curved cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray

# Corner pairs of the six edges; mid-nodes 4 to 9 of a tet10 follow this order.
EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
# The two corners opposite to each of these edges.
_OPPOSITE = np.array([[2, 3], [0, 3], [1, 3], [1, 2], [0, 2], [0, 1]])
# barycentric coordinates of the 4-point Gauss rule, degree 2
_GAUSS_A, _GAUSS_B = 0.1381966011250105, 0.5854101966249685


@dataclass(frozen=True)
class MeshQuality:
    """Quality figures of a mesh; angles are dihedral."""

    n_nodes: int
    n_cells: int
    n_corner_nodes: int
    min_angle_deg: float
    min_angle_under_probe_deg: float
    max_angle_deg: float
    share_below_10_deg: float
    min_volume_mm3: float
    volume_mm3: float
    min_scaled_jacobian: float
    inverted_cells: int
    edge_under_probe_mm: float
    edge_far_mm: float


def volumes(points: Array, cells: IntArray) -> Array:
    """Signed volume (n_cells,) of tetrahedra from their corners.

    >>> volumes(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    array([0.16666667])
    """
    a, b, c, d = np.moveaxis(points[cells[:, :4]], 1, 0)
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def dihedral_angles_deg(points: Array, cells: IntArray) -> Array:
    """(n_cells, 6) interior angles between the two faces at each edge, in the order of EDGES.

    >>> regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    >>> dihedral_angles_deg(regular, np.array([[0, 2, 1, 3]])).round(3)[0, 0]
    np.float64(70.529)
    """
    x = points[cells[:, :4]]
    out = np.empty((len(cells), 6))
    for k, ((i, j), (m, n)) in enumerate(zip(EDGES, _OPPOSITE, strict=True)):
        e = x[:, j] - x[:, i]
        u, v = np.cross(e, x[:, m] - x[:, i]), np.cross(e, x[:, n] - x[:, i])
        cosine = np.einsum("ij,ij->i", u, v)
        sine = np.linalg.norm(np.cross(u, v), axis=1)
        out[:, k] = np.degrees(np.arctan2(sine, cosine))
    return out


def edge_lengths(points: Array, cells: IntArray) -> Array:
    """(n_cells, 6) lengths (mm) in the order of EDGES."""
    x = points[cells[:, :4]]
    return np.linalg.norm(x[:, EDGES[:, 0]] - x[:, EDGES[:, 1]], axis=2)


def scaled_jacobians(points: Array, cells: IntArray) -> Array:
    """Smallest det(dx/dxi) at a cell's nodes and Gauss points, over that of a regular cell of equal edge.

    1 for a regular tetrahedron, 0 if flat, negative if inverted; the edge is the mean. For tet10 the mapping
    is evaluated at all ten nodes and the four Gauss points; for tet4 it is constant.

    >>> regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    >>> scaled_jacobians(regular, np.array([[0, 2, 1, 3]])).round(6)
    array([1.])
    """
    mean = edge_lengths(points, cells).mean(axis=1)
    full = mean**3 / np.sqrt(2.0)
    if cells.shape[1] == 4:
        return 6 * volumes(points, cells) / full
    x = points[cells]
    lowest = np.full(len(cells), np.inf)
    for gradient in _tet10_gradients():
        jacobian = np.einsum("nia,ib->nab", x, gradient)
        lowest = np.minimum(lowest, np.linalg.det(jacobian))
    return lowest / full


def _tet10_gradients() -> list[Array]:
    """Shape function gradients (10, 3) at the nodes and the four Gauss points."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    middles = corners[EDGES].mean(axis=1)
    gauss = np.full((4, 3), _GAUSS_A)
    gauss[1:] += (_GAUSS_B - _GAUSS_A) * np.eye(3)
    return [tet10_gradient(at) for at in np.vstack([corners, middles, gauss])]


def tet10_gradient(at: Array) -> Array:
    """d(shape functions)/d(xi) (10, 3) of the quadratic tetrahedron at xi (3,)."""
    barycentric = np.array([1 - at.sum(), *at])
    slopes = np.vstack([-np.ones(3), np.eye(3)])
    corner = (4 * barycentric - 1)[:, None] * slopes
    i, j = EDGES.T
    middle = 4 * (barycentric[i][:, None] * slopes[j] + barycentric[j][:, None] * slopes[i])
    return np.vstack([corner, middle])


def quality(
    points: Array, cells: IntArray, under_probe: NDArray[np.bool_], at_face: NDArray[np.bool_] | None = None
) -> MeshQuality:
    """All figures; `under_probe` (n_cells,) marks the fine zone, `at_face` the cells at the face."""
    angles = dihedral_angles_deg(points, cells)
    volume = volumes(points, cells)
    edges = edge_lengths(points, cells)
    jacobian = scaled_jacobians(points, cells)
    lowest = angles.min(axis=1)
    near = under_probe if under_probe.any() else np.ones(len(cells), bool)
    far = ~under_probe if (~under_probe).any() else near
    return MeshQuality(
        n_nodes=len(np.unique(cells)),
        n_cells=len(cells),
        n_corner_nodes=len(np.unique(cells[:, :4])),
        min_angle_deg=float(lowest.min()),
        min_angle_under_probe_deg=float(lowest[near].min()),
        max_angle_deg=float(angles.max()),
        share_below_10_deg=float((lowest < 10).mean()),
        min_volume_mm3=float(volume.min()),
        volume_mm3=float(volume.sum()),
        min_scaled_jacobian=float(jacobian.min()),
        inverted_cells=int((jacobian <= 0).sum()),
        edge_under_probe_mm=float(
            np.median(edges[near if at_face is None or not at_face.any() else at_face])
        ),
        edge_far_mm=float(np.quantile(edges[far], 0.75)),
    )
