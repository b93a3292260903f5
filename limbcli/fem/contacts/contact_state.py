"""Contact of the soft surfaces with the rigid ones, as found at one state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.fem.contacts.contact_points import TRACTION
from limbcli.fem.motion.state import State
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class ContactState:
    """What `System.search` finds at a state: contact forces and tangent are functions of it.

    state : where it was searched, with the rigid facets that are touched as its `hints`, and without
        independent volume ratios
    points : for each pair, the state of the points of its patches (n_facets, n_gauss, n_columns), see
        `contact_points`
    n_touching : number of points in contact
    full_tangent : True for the exact tangent; False omits terms that are harmful far from equilibrium, where
        the tractions are many times too large: their change due to rotating normals, and with friction the
        zero stiffness along a slip
    """

    state: State
    points: tuple[tuple[Array, ...], ...]
    n_touching: int
    full_tangent: bool = True

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Which points of all patches, one after the other, are in contact."""
        each = [points[..., TRACTION].ravel() > 0 for pair in self.points for points in pair]
        return np.concatenate([*each, np.zeros(0, dtype=bool)])
