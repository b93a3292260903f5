"""Prescribed contraction of fibres along a0: Cauchy stress T0/J (F a0)(F a0), i.e. S = T0 a0 a0.

Source: FEBio User Manual 4.0, "Prescribed Fiber Active Contraction".
"""

from __future__ import annotations

from typing import Any

from limbcli.materials.fiber import fibre_dyad, stretch_square
from limbcli.materials.kernel import Deformation, Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.numbers.compiled import njit


@njit
def add_contraction(par, off, extra, J, work, S, CC, tangent):
    """par[off:] = T0, a0x, a0y, a0z."""
    A = work[0][1]
    fibre_dyad(par, off + 1, A)
    for p in range(6):
        S[p] += par[off] * A[p]


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """T0/2 (I4 - 1) (n_cells, n_gauss) MPa; p (n_cells, 4, 1)."""
    return 0.5 * p[:, 0] * (stretch_square(p, 1, at.C)[1] - 1)


LAW = Law(
    "active_contraction",
    Kernel(add_contraction, energy, works=True),
    {"T0": None},
    lambda v: [v["T0"]],
    fiber=True,
    febio=FebioNames("prescribed fiber active contraction", (("T0", "T0"),)),
)
