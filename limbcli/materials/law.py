"""Definition of a named law: its parameters, and their conversion to the numbers of its kernel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from limbcli.materials.kernel import Kernel

Values = Mapping[str, Any]


@dataclass(frozen=True)
class FebioNames:
    """FEBio's names of a law and its parameters, used by `feb` for writing and reading.

    parameters : pairs (FEBio's name, ours)
    elastic_constants : whether FEBio's E and v correspond to mu and lambda here
    """

    material: str
    parameters: tuple[tuple[str, str], ...] = ()
    elastic_constants: bool = False


@dataclass(frozen=True)
class Law:
    """An elementary law, with the name by which a `Material` refers to it.

    The stress is linear in most of a kernel's numbers ("slots"); for the others a separate kernel computes
    the derivative of the stress, so that dR/dp is obtained by the same internal-force loop.

    parameters : names with default values (None: required)
    slots : parameters -> numbers, in the kernel's order; must be smooth, since it is differentiated with a
        complex step
    derivatives : slot -> (kernel, extra), or None if the slot does not depend on a parameter; slots not
        listed are linear
    extra : parameters -> third number of the kernel's row in a program
    positive : parameters that must be greater than 0
    check : given parameters -> (problem, fix), or None
    terms : whether the parameters belong to a sum of terms; terms that are not given are omitted. The slots
        are then kappa, c1, m1, c2, m2 ..., and the stress of a term is proportional to its c
    fiber : whether the law has a fibre direction, stored after its numbers
    uncoupled : whether the stress splits into an isochoric deviator and a pressure
    febio : FEBio's names; None if FEBio does not have the law
    """

    name: str
    kernel: Kernel
    parameters: Mapping[str, float | None]
    slots: Callable[[Values], Sequence[Any]]
    derivatives: Mapping[int, tuple[Kernel, int] | None] = field(default_factory=dict)
    extra: Callable[[Values], int] = lambda values: 0
    positive: tuple[str, ...] = ()
    check: Callable[[Values], tuple[str, str] | None] = lambda values: None
    terms: bool = False
    fiber: bool = False
    uncoupled: bool = False
    febio: FebioNames | None = None
