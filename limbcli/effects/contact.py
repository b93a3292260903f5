"""The contact penalty lets the probe sink into the skin, or the facets make the force curve uneven.

A gap g = p/eps acts in series with the tissue. At 20 times the tissue's own stiffness the force of tet10 is 2
to 3 % low at m 2; where a large m makes the tissue many times stiffer under the probe than at rest, it is low
by a quarter or more. The test uses a quarter of the penalty, for which a solver converges more easily than
for four times the penalty.
Tell-tale: a force low by a constant fraction; a staircase in the curve.
Source: Wriggers 2006, Computational Contact Mechanics, section 6.3.
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.model import LimbModel

FACTOR = Parameter(
    "penalty_factor", null=1.0, start=0.25, low=0.1, high=10.0, typical=0.25, prior="1 is the default"
)


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    factor = theta[FACTOR.name]
    if factor == 1.0:
        return model
    return replace(model, contacts=tuple(replace(c, penalty=c.penalty * factor) for c in model.contacts))


EFFECT = Effect(
    name="contact",
    sentence="the contact is too soft: the probe penetrates the skin of the model",
    kind="numerical",
    source="Wriggers 2006, Computational Contact Mechanics, section 6.3",
    parameters=(FACTOR,),
    apply=apply,
    solves=True,
)
