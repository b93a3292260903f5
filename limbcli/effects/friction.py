"""The skin does not slide freely under the probe: Coulomb friction.

|t_T| <= mu p; dry skin about 0.5, with gel 0.02 to 0.15. The force grows by about 1 % on a nearly
incompressible layer and by a few per cent at large depth, which is practically invisible in force and mean
speed. The effect levels off where the skin sticks: on two limbs (m 2 and 6, f_kappa 100, down to 30 % of the
tissue) coefficients of 0.1, 0.2, 0.3, 0.5 added 0.37 to 0.44, 0.6 to 0.77, 0.7 to 0.89, 0.88 to 0.96 of the
increase by a coefficient of 1.
FEBio: `fric_coeff` of `sliding-elastic`, non-symmetric.
Tell-tale: superficial speeds a few per cent low; speckle beside the probe's edge does not slip.
Source: Zhang & Mak 1999, Prosthet Orthot Int 23:135 (friction of skin).
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.model import LimbModel

COEFFICIENT = Parameter("friction_coefficient", null=0.0, start=0.2, low=0.0, high=1.0, typical=0.15,
                        prior="gel 0.02 to 0.15, dry 0.5", saturates=0.17,
                        reported="coefficient")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    mu = theta[COEFFICIENT.name]
    if mu == 0.0:
        return model
    contacts = tuple(replace(each, friction=mu, symmetric=False, knmult=1.0) for each in model.contacts)
    steps = tuple(
        replace(each, control={**each.control, "symmetric_stiffness": "non-symmetric"})
        for each in model.steps
    )
    return replace(model, contacts=contacts, steps=steps)


EFFECT = Effect(
    name="friction",
    sentence="the skin sticks to the probe instead of sliding",
    kind="tissue",
    source="Zhang & Mak 1999, Prosthet Orthot Int 23:135",
    parameters=(COEFFICIENT,),
    needs=("force", "map"),
    apply=apply,
    solves=True,
)
