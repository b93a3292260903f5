"""The law has a different form: unequal weights of the two exponents, or a second, steeper pair.

c1 = q c, c2 = (1 - q) c: third-order stiffness A/mu = -6 + m (2q - 1); the ground-state modulus is unchanged.
A further pair (s c/2, M), (s c/2, -M) with c reduced to (1 - s) c adds stiffening at large strain.
FEBio: the same `Ogden unconstrained` with c1 to c4.
Tell-tale: force and speed over depth require different m.
Source: Destrade & Ogden 2010, J Acoust Soc Am 128:3334 (third- and fourth-order constants).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.tissue import TISSUE, core, ground_modulus, with_core
from limbcli.model import LimbModel

EXPONENT = "second_exponent"
WEIGHT = Parameter("weight_q", null=0.5, start=0.6, low=0.0, high=1.0, typical=0.8, prior="0 to 1",
                   natural_bounds=True, reported="q")  # fmt: skip
SECOND = Parameter("second_pair_share", null=0.0, start=0.1, low=0.0, high=0.6, typical=0.2, prior="0 to 0.5")


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    q, share = theta[WEIGHT.name], theta[SECOND.name]
    if q == 0.5 and share == 0.0:
        return model
    law = core(model.materials[TISSUE])
    c, m = ground_modulus(model), float(law.parameters["m1"])  # type: ignore[arg-type]
    M = theta.get(EXPONENT, 12.0)
    first = {"c1": (1 - share) * q * c, "m1": m, "c2": (1 - share) * (1 - q) * c, "m2": -m}
    second = {"c3": share * c / 2, "m3": M, "c4": share * c / 2, "m4": -M} if share else {}
    return with_core(model, law.with_parameters(**first, **second))


EFFECT = Effect(
    name="nonlinearity",
    sentence="the tissue stiffens along a different curve than one pair of exponents allows",
    kind="tissue",
    source="Destrade & Ogden 2010, J Acoust Soc Am 128:3334",
    parameters=(WEIGHT, SECOND),
    apply=apply,
    grid=({EXPONENT: 12.0},),
    solves=True,
)
