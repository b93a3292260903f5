"""FEBio's material tags and our names of the laws: one table for reader and writer.

Elementary laws define their own names (`materials.law.FebioNames`); those that wrap other laws are listed
here. Parameters that only change their name are listed as (FEBio's, ours). FEBio writes some laws with
Young's modulus and Poisson's ratio, while the model stores Lame's constants; `lame` and `young` convert
between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from limbcli.materials import LAWS
from limbcli.model import Array

_Number = TypeVar("_Number", float, Array)
_PRONY = (("g0", "g0"), *((f"{letter}{k}", f"{letter}{k}") for k in range(1, 7) for letter in "gt"))


@dataclass(frozen=True)
class LawTag:
    """Representation of a law in a model file.

    parameters : (FEBio's tag, our name) of scalar parameters
    elastic_constants : E, v in the file are mu, lambda in the model
    part : child tag of the parts, and their required number (None: any)
    fiber : the law has a <fiber> direction (parameter "fiber", a unit vector or a map)
    has_density : FEBio accepts <density> in it
    """

    law: str
    febio: str
    parameters: tuple[tuple[str, str], ...] = ()
    elastic_constants: bool = False
    part: str | None = None
    n_parts: int | None = 0
    fiber: bool = False
    has_density: bool = True


_WRAPPERS = (
    LawTag("mixture", "solid mixture", part="solid", n_parts=None),
    LawTag("viscoelastic", "viscoelastic", _PRONY, part="elastic", n_parts=1),
    LawTag("prestrain", "prestrain elastic", part="elastic", n_parts=1),
    LawTag(
        "biphasic",
        "biphasic",
        (("phi0", "phi0"), ("fluid_density", "fluid_density")),
        part="solid",
        n_parts=1,
        has_density=False,
    ),
)


def law_tags() -> tuple[LawTag, ...]:
    """All laws that can be written to a FEBio file."""
    own = (
        LawTag(each.name, names.material, names.parameters, names.elastic_constants, fiber=each.fiber)
        for each in LAWS.values()
        if (names := each.febio) is not None
    )
    return (*own, *_WRAPPERS)


def tag_of_law(law: str) -> LawTag | None:
    """The law of our name."""
    return next((each for each in law_tags() if each.law == law), None)


def tag_of_febio(material: str) -> LawTag | None:
    """The law of FEBio's name."""
    return next((each for each in law_tags() if each.febio == material), None)


def lame(young: _Number, poisson: _Number) -> tuple[_Number, _Number]:
    """(mu, lambda) of (E, nu), numbers or arrays of them.

    >>> lame(3.0, 0.5 - 0.25)
    (1.2, 1.2)
    """
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def young(mu: _Number, lam: _Number) -> tuple[_Number, _Number]:
    """(E, nu) of (mu, lambda), numbers or arrays of them.

    >>> young(1.2, 1.2)
    (3.0, 0.25)
    """
    return mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
