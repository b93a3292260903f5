"""Detects unconstrained parts of the tissue by testing their rigid motions before any load.

A factor in single precision cannot distinguish zero stiffness from round-off, so the rigid motions
themselves are tested: for every connected part, those that are compatible with its supports.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.equilibrium.tangent import Tangent
from limbcli.fem.linear_solvers.singular import SingularMatrix
from limbcli.model import Array, IntArray

# Resistance v.K v of a rigid motion regarded as zero, as a fraction of the same with K's diagonal only.
_NOTHING = 1e-8
# Displacement at constrained degrees of freedom above which a support prevents a rigid motion, relative to
# the motion's largest displacement.
_HELD = 1e-6
_NAMES = ("along x", "along y", "along z", "about x", "about y", "about z")


def check_held(tangent: Tangent, contact: ContactState) -> None:
    """Raise if a part of the tissue can move as a rigid body without resistance.

    Contact is included; nodes tied to bodies are treated as constrained, the bodies are
    checked separately (`tangent.check_rigid_modes`).

    Raises SingularMatrix, which tells the motion, the part's number of nodes and its centroid.
    """
    system = tangent.system
    for nodes in _parts(len(system.X), [g.cells for g in system.groups]):
        motions, names = _free_motions(system.X[nodes], system.free[nodes])
        for motion, name in zip(motions, names, strict=True):
            v = np.zeros_like(system.X)
            v[nodes] = motion
            if _resistance(tangent, contact, np.where(system.free, v, 0.0)) > _NOTHING:
                continue
            middle = system.X[nodes].mean(axis=0)
            raise SingularMatrix(
                f"a part of the tissue, {len(nodes)} nodes, can move freely {name}: it is not constrained",
                where=f"around ({middle[0]:.1f}, {middle[1]:.1f}, {middle[2]:.1f}) mm",
                fix="constrain it: fix its nodes at the bone or at the cuts, or join its mesh to the rest",
            )


def _parts(n_points: int, cell_lists: list[IntArray]) -> list[IntArray]:
    """The nodes of each connected part."""
    links = [
        np.stack([cells[:, :1].repeat(cells.shape[1] - 1, axis=1).ravel(), cells[:, 1:].ravel()])
        for cells in cell_lists
    ]
    pairs = np.concatenate(links, axis=1) if links else np.zeros((2, 0), dtype=np.int64)
    ones = np.ones(pairs.shape[1], dtype=np.int8)
    graph = sparse.coo_matrix((ones, (pairs[0], pairs[1])), shape=(n_points, n_points))
    label = connected_components(graph, directed=False)[1]
    used = np.unique(pairs)
    return [used[label[used] == part] for part in np.unique(label[used])]


def _free_motions(X: Array, free: NDArray[np.bool_]) -> tuple[Array, list[str]]:
    """Rigid motions (n_motions, n_nodes, 3) that move no constrained degree of freedom, and their names."""
    x = X - X.mean(axis=0)
    size = max(float(np.abs(x).max(initial=0.0)), 1e-12)
    turns = [np.cross(axis, x) / size for axis in np.eye(3)]
    every = np.stack([*(np.broadcast_to(axis, x.shape) for axis in np.eye(3)), *turns])
    hindered = every[:, ~free]
    values, vectors = np.linalg.eigh(hindered @ hindered.T / max(len(X), 1))
    chosen = vectors[:, values < _HELD**2].T
    names = [_NAMES[int(np.argmax(np.abs(each)))] for each in chosen]
    return np.einsum("mk,kni->mni", chosen, every), names


def _resistance(tangent: Tangent, contact: ContactState, v: Array) -> float:
    """v.K v relative to the same with only K's diagonal; 1 where the latter is zero."""
    system = tangent.system
    step = np.zeros(system.n_unknowns)
    step[: system.n_tissue] = v[system.free]
    diagonal = tangent.diagonal()
    most = float((diagonal * step[: system.n_tissue] ** 2).sum())
    return float(step @ tangent.times(contact, step)) / most if most > 0 else 1.0
