"""What a law is by name: its parameters, and how these become the numbers of its kernel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from limbcli.materials.kernel import Kernel

Values = Mapping[str, Any]


@dataclass(frozen=True)
class FebioNames:
    """What FEBio calls a law. `feb` writes and reads it by these names.

    parameters : (FEBio's, ours); elastic_constants : E and v there are mu and lambda here
    """

    material: str
    parameters: tuple[tuple[str, str], ...] = ()
    elastic_constants: bool = False


@dataclass(frozen=True)
class Law:
    """One elementary law, under the name by which a `Material` asks for it.

    The stress is linear in most of a kernel's numbers ("slots"); for the others a kernel of their own gives
    the derivative of the stress, so that dR/dp is the internal-force loop itself.

    parameters : names with their default (None: it must be given)
    slots : parameters -> numbers, in the kernel's order; smooth, as it is differentiated with a complex step
    derivatives : slot -> (kernel, extra); None for a number that is no parameter. Slots not listed are linear
    extra : parameters -> third number of the kernel's row
    positive : parameters that must be greater than 0
    check : given parameters -> (what is wrong, what to do), or None
    terms : its parameters are those of a sum; terms that are not given are left out
    fiber : it has a direction, which follows its numbers
    uncoupled : its stress is a deviator and a pressure apart
    febio : its names there; None where FEBio does not have it
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
