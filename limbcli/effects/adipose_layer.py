"""Fat below the skin: a soft layer over muscle.

c_fat / c in a layer of 4 to 12 mm below the skin: a long toe, then strong stiffening when the fat
bottoms out (which looks like a large m).
FEBio: element maps of c1, c2, cp.
Tell-tale: superficial speeds low at rest and rising fast, deep ones slow to follow.
Source: Comley & Fleck 2010, Int J Solids Struct 47:2982 (fat: shear modulus 0.2 to 2 kPa).
"""

from __future__ import annotations

import numpy as np

from limbcli.effects.base import Effect, Parameter, Theta
from limbcli.effects.tissue import layer_share, scaled
from limbcli.model import LimbModel

THICKNESS = "fat_thickness_mm"
SOFTNESS = Parameter("log_fat_softness", null=0.0, start=0.7, low=0.0, high=3.0, typical=1.0,
                     prior="fat 0.2 to 2 kPa under muscle of 2 to 6 kPa: 1 to 3")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """ln of c / c_fat is the parameter: 0 without fat, 0.7 for half as stiff."""
    ratio = float(np.exp(-theta[SOFTNESS.name]))
    if ratio == 1.0:
        return model
    share = layer_share(model, 0.0, theta.get(THICKNESS, 6.0))
    return scaled(model, 1.0 + share * (ratio - 1.0))


EFFECT = Effect(
    name="adipose-layer",
    sentence="a layer of fat, softer than the muscle below, lies under the skin",
    kind="tissue",
    source="Comley & Fleck 2010, Int J Solids Struct 47:2982",
    parameters=(SOFTNESS,),
    apply=apply,
    grid=({THICKNESS: 6.0}, {THICKNESS: 10.0}),
    solves=True,
    tell_tale="a long toe, then strong stiffening; shallow speeds low",
)
