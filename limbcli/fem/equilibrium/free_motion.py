"""Parts of the tissue that nothing holds: found by their rigid motions, before any load.

A factor in single precision cannot distinguish zero stiffness from round-off, so the motions themselves
are tried: of every connected part, those that leave its given displacements alone.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from limbcli.fem.equilibrium.tangent import Tangent
from limbcli.fem.linear_solvers.singular import SingularMatrix
from limbcli.fem.motion.state import State
from limbcli.model import Array, IntArray

_NOTHING = 1e-8  # resistance, of what the same displacements meet node by node
_HELD = 1e-6  # of the largest way, above which a given displacement hinders a motion
_NAMES = ("along x", "along y", "along z", "about x", "about y", "about z")


def check_held(tangent: Tangent, state: State) -> None:
    """Raise where a part of the tissue can move as a rigid body against no resistance.

    Contact counts as it was searched last; tied nodes move with their bodies, which are checked for
    themselves (`tangent.check_rigid_modes`).

    Raises
    ------
    SingularMatrix
        With the motion, the number of nodes of the part and its middle.
    """
    system = tangent.system
    for nodes in _parts(len(system.X), [g.cells for g in system.groups]):
        motions, names = _free_motions(system.X[nodes], system.free[nodes])
        for motion, name in zip(motions, names, strict=True):
            v = np.zeros_like(system.X)
            v[nodes] = motion
            if _resistance(tangent, state, np.where(system.free, v, 0.0)) > _NOTHING:
                continue
            middle = system.X[nodes].mean(axis=0)
            raise SingularMatrix(
                f"a part of the tissue, {len(nodes)} nodes, can move freely {name}: it is not constrained",
                where=f"around ({middle[0]:.1f}, {middle[1]:.1f}, {middle[2]:.1f}) mm",
                fix="constrain it: fix its nodes at the bone or at the cuts, or join its mesh to the rest",
            )


def _parts(n_points: int, cell_lists: list[IntArray]) -> list[IntArray]:
    """Nodes of every connected part."""
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
    """Rigid motions (n_motions, n_nodes, 3) that leave all alone that is not free, and their names."""
    x = X - X.mean(axis=0)
    size = max(float(np.abs(x).max(initial=0.0)), 1e-12)
    turns = [np.cross(axis, x) / size for axis in np.eye(3)]
    every = np.stack([*(np.broadcast_to(axis, x.shape) for axis in np.eye(3)), *turns])
    hindered = every[:, ~free]
    values, vectors = np.linalg.eigh(hindered @ hindered.T / max(len(X), 1))
    chosen = vectors[:, values < _HELD**2].T
    names = [_NAMES[int(np.argmax(np.abs(each)))] for each in chosen]
    return np.einsum("mk,kni->mni", chosen, every), names


def _resistance(tangent: Tangent, state: State, v: Array) -> float:
    """v.K v over the same sum with K's diagonal alone."""
    system = tangent.system
    step = np.zeros(system.n_unknowns)
    step[: system.n_tissue] = v[system.free]
    diagonal = tangent.diagonal()
    most = float((diagonal * step[: system.n_tissue] ** 2).sum())
    return float(step @ tangent.times(state, step)) / most if most > 0 else 1.0
