"""FEBio's material tags and what the laws are called inside: one table for reader and writer.

Parameters that only change their name are listed as (FEBio's, ours). Two laws
are written by FEBio with Young's modulus and Poisson's ratio and kept inside
with Lame's constants; `lame` and `young` convert.
"""

from __future__ import annotations

from dataclasses import dataclass

_TERMS = tuple((f"{letter}{k}", f"{letter}{k}") for k in range(1, 7) for letter in "cm")
_PRONY = (("g0", "g0"), *((f"{letter}{k}", f"{letter}{k}") for k in range(1, 7) for letter in "gt"))


@dataclass(frozen=True)
class LawTag:
    """How one law is written in a model file.

    parameters : (FEBio's tag, our name) of scalar parameters
    elastic_constants : E, v in the file are mu, lambda inside
    part : the child tag that holds the parts, and how many there must be (None: any)
    fiber : it has a <fiber> direction (parameter "fiber", a unit vector or a map)
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


LAW_TAGS = (
    LawTag("ogden", "Ogden unconstrained", (("cp", "kappa"), *_TERMS)),
    LawTag("neo_hooke", "neo-Hookean", elastic_constants=True),
    LawTag("mooney_rivlin", "Mooney-Rivlin", (("c1", "c1"), ("c2", "c2"), ("k", "kappa"))),
    LawTag("ogden_uncoupled", "Ogden", (("k", "kappa"), *_TERMS)),
    LawTag("holmes_mow", "Holmes-Mow", (("beta", "beta"),), elastic_constants=True),
    LawTag("mixture", "solid mixture", part="solid", n_parts=None),
    LawTag(
        "fiber_exp_pow",
        "fiber-exp-pow",
        tuple((name, name) for name in ("ksi", "alpha", "beta", "mu", "lam0")),
        fiber=True,
    ),
    LawTag("active_contraction", "prescribed fiber active contraction", (("T0", "T0"),), fiber=True),
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
BY_FEBIO = {each.febio: each for each in LAW_TAGS}
BY_LAW = {each.law: each for each in LAW_TAGS}


def lame(young: float, poisson: float) -> tuple[float, float]:
    """(mu, lambda) of (E, nu).

    >>> lame(3.0, 0.5 - 0.25)
    (1.2, 1.2)
    """
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def young(mu: float, lam: float) -> tuple[float, float]:
    """(E, nu) of (mu, lambda).

    >>> young(1.2, 1.2)
    (3.0, 0.25)
    """
    return mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
