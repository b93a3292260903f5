"""The laws by name: their parameters, and how these become the numbers of a kernel.

A law's `slots` turns its parameters into the numbers that its kernel reads. The
stress is linear in most of these; for the others `kernels` names the kernel that
gives the derivative of the stress.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from limbcli.materials import dispatch
from limbcli.materials.fiber import ALPHA, BAND, BETA, JUMP, LAM0
from limbcli.materials.ogden import MAX_TERMS

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Law:
    """One elementary law.

    parameters : names with their default (None: it must be given)
    slots : parameters -> numbers, in the kernel's order
    kernels : slot -> (kernel, extra) of the derivative; slots not listed are linear
    extra : parameters -> third number of the kernel's row
    positive : parameters that must be greater than 0
    """

    kernel: int
    parameters: Mapping[str, float | None]
    slots: Callable[[Values], Sequence[Any]]
    kernels: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    extra: Callable[[Values], int] = lambda values: 0
    positive: tuple[str, ...] = ()
    fiber: bool = False


def _terms(values: Values) -> int:
    return max((k for k in range(1, MAX_TERMS + 1) if f"c{k}" in values), default=0)


def _ogden_slots(values: Values) -> list[Any]:
    slots = [values["kappa"]]
    for k in range(1, _terms(values) + 1):
        slots += [values.get(f"c{k}", 0.0), values.get(f"m{k}", 1.0)]
    return slots


def _exponents(kernel: int) -> dict[int, tuple[int, int]]:
    return {2 + 2 * k: (kernel, k) for k in range(MAX_TERMS)}


_FIXED = (0, 0)  # a number that is no parameter

_OGDEN: dict[str, float | None] = {"kappa": None, "c1": None, "m1": None}
_OGDEN |= {f"{letter}{k}": 0.0 for k in range(2, MAX_TERMS + 1) for letter in "cm"}

LEAVES: Mapping[str, Law] = {
    "ogden": Law(
        dispatch.OGDEN, _OGDEN, _ogden_slots, _exponents(dispatch.OGDEN_DM), _terms, positive=("kappa",)
    ),
    "ogden_uncoupled": Law(
        dispatch.UNCOUPLED,
        _OGDEN,
        _ogden_slots,
        _exponents(dispatch.UNCOUPLED_DM),
        _terms,
        positive=("kappa",),
    ),
    "mooney_rivlin": Law(  # c1 (I1 - 3) + c2 (I2 - 3): Ogden terms of exponents 2 and -2 with 4 c
        dispatch.UNCOUPLED,
        {"c1": None, "c2": 0.0, "kappa": None},
        lambda v: [v["kappa"], 4.0 * v["c1"], 2.0, 4.0 * v["c2"], -2.0],
        {2: _FIXED, 4: _FIXED},
        extra=lambda v: 2,
        positive=("kappa",),
    ),
    "neo_hooke": Law(
        dispatch.NEO_HOOKE,
        {"mu": None, "lambda": None},
        lambda v: [v["mu"], v["lambda"]],
        positive=("mu",),
    ),
    "holmes_mow": Law(
        dispatch.HOLMES_MOW,
        {"mu": None, "lambda": None, "beta": None},
        lambda v: [v["mu"], v["lambda"], v["beta"]],
        {k: (dispatch.HOLMES_MOW_D, k) for k in range(3)},
        positive=("mu",),
    ),
    "fiber_exp_pow": Law(
        dispatch.FIBER,
        {"ksi": None, "alpha": 0.0, "beta": 2.0, "mu": 0.0, "lam0": 1.0, "band": JUMP},
        lambda v: [v["ksi"], v["alpha"], v["beta"], v["mu"], v["lam0"], v["band"]],
        {k: (dispatch.FIBER_D, k) for k in (ALPHA, BETA, LAM0, BAND)},
        fiber=True,
    ),
    "active_contraction": Law(dispatch.CONTRACTION, {"T0": None}, lambda v: [v["T0"]], fiber=True),
}

WRAPPERS = ("mixture", "viscoelastic", "prestrain")
UNCOUPLED_LAWS = frozenset({"ogden_uncoupled", "mooney_rivlin"})
LAWS = (*LEAVES, *WRAPPERS)
