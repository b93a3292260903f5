"""Shape functions of the cells and facets, in FEBio's (VTK's) node order."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, IntArray

# corner nodes of the edges, in the order of their midside nodes
_TET10_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_TRI6_EDGES = ((0, 1), (1, 2), (2, 0))
_HEX8 = np.array(
    [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
    dtype=float,
)


def shape(kind: str, points: Array) -> tuple[Array, Array]:
    """N (n_points, n_nodes) and dN (n_points, n_nodes, n_dimensions) at natural coordinates.

    >>> N, dN = shape("tet10", np.array([[0.2, 0.3, 0.1]]))
    >>> round(float(N.sum()), 12), bool(abs(dN.sum(axis=1)).max() < 1e-12)
    (1.0, True)
    """
    if kind in ("tet4", "tet10", "tri3", "tri6"):
        return _simplex(kind, points)
    if kind == "penta6":
        return _penta6(points)
    if kind == "quad4":
        return _tensor(points, _HEX8[:4, :2])
    return _tensor(points, _HEX8)


def _simplex(kind: str, points: Array) -> tuple[Array, Array]:
    dimension = 3 if kind.startswith("tet") else 2
    L = np.concatenate([1.0 - points.sum(axis=1, keepdims=True), points], axis=1)
    dL = np.concatenate([-np.ones((1, dimension)), np.eye(dimension)])
    if kind in ("tet4", "tri3"):
        return L, np.repeat(dL[None], len(points), axis=0)
    edges = _TET10_EDGES if dimension == 3 else _TRI6_EDGES
    N = [L[:, a] * (2 * L[:, a] - 1) for a in range(dimension + 1)]
    dN = [(4 * L[:, a, None] - 1) * dL[a] for a in range(dimension + 1)]
    for a, b in edges:
        N.append(4 * L[:, a] * L[:, b])
        dN.append(4 * (L[:, a, None] * dL[b] + L[:, b, None] * dL[a]))
    return np.stack(N, axis=1), np.stack(dN, axis=1)


def _tensor(points: Array, corners: Array) -> tuple[Array, Array]:
    dimension = corners.shape[1]
    factors = 1 + points[:, None, :] * corners[None]
    scale = 0.5**dimension
    N = scale * factors.prod(axis=2)
    dN = np.empty((*N.shape, dimension))
    for i in range(dimension):
        others = [j for j in range(dimension) if j != i]
        dN[:, :, i] = scale * corners[:, i] * factors[:, :, others].prod(axis=2)
    return N, dN


def _penta6(points: Array) -> tuple[Array, Array]:
    flat, dflat = _simplex("tri3", points[:, :2])
    t = points[:, 2:]
    N = np.concatenate([flat * (1 - t) / 2, flat * (1 + t) / 2], axis=1)
    plane = np.concatenate([dflat * (1 - t[:, None]) / 2, dflat * (1 + t[:, None]) / 2], axis=1)
    axis = np.concatenate([-flat / 2, flat / 2], axis=1)[:, :, None]
    return N, np.concatenate([plane, axis], axis=2)


def reference_gradients(
    points: Array, cells: IntArray, kind: str, rule: tuple[Array, Array]
) -> tuple[Array, Array]:
    """dN/dX (n_cells, n_gauss, n_nodes, 3) and weights times Jacobian (n_cells, n_gauss)."""
    _, dN = shape(kind, rule[0])
    X = points[cells]
    jacobian = np.einsum("cni,gnj->cgij", X, dN, optimize=True)
    volume = np.linalg.det(jacobian) * rule[1]
    inverse = np.linalg.inv(np.where(volume[..., None, None] == 0, np.eye(3), jacobian))
    return np.ascontiguousarray(np.einsum("gnj,cgji->cgni", dN, inverse, optimize=True)), volume
