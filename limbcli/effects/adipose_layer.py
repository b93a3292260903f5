"""Fat below the skin: a soft layer over muscle.

A layer of some millimetres below the skin whose stiffness is c_fat / c times that of the tissue. The force
curve has a long toe, then stiffens strongly when the fat is compressed to its limit (which resembles a large
m).
FEBio: element maps of c1, c2, cp.
Tell-tale: superficial speeds are low at rest and rise fast; deep ones follow slowly.
Source: Comley & Fleck 2010, Int J Solids Struct 47:2982 (fat: shear modulus 0.2 to 2 kPa).
"""

from __future__ import annotations

import math

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.stiffness_places import Places
from limbcli.model import Array

THICKNESS = "fat_thickness_mm"
THICK = Parameter.of_shape(THICKNESS, 6.0, 1.5, 20.0, "2 to 15 mm at the calf")


def ratio(softness: float, c_kpa: float) -> float:
    """c of the fat over that of the tissue."""
    return math.exp(-softness)


SOFTNESS = Parameter("log_fat_softness", null=0.0, start=0.7, low=0.0, high=3.0, typical=1.0,
                     prior="fat 0.2 to 2 kPa under muscle of 2 to 6 kPa: 1 to 3",
                     reported="stiffness_ratio", turn=ratio)  # fmt: skip

_EDGE_MM = 0.4


def stiffness(places: Places, theta: Theta) -> Array:
    """Stiffness factor at places; the parameter is ln(c / c_fat): 0 without fat, 0.7 for half as stiff."""
    beyond = places.below_skin - theta.get(THICKNESS, 6.0)
    inside = 1.0 / (1.0 + np.exp(np.clip(beyond / _EDGE_MM, -40, 40)))
    return np.asarray(1.0 + inside * np.expm1(-theta[SOFTNESS.name]))


EFFECT = Effect(
    name="adipose-layer",
    sentence="a layer of fat, softer than the muscle below, lies under the skin",
    kind="tissue",
    source="Comley & Fleck 2010, Int J Solids Struct 47:2982",
    parameters=(SOFTNESS, THICK),
    stiffness=stiffness,
    grid=({THICKNESS: 6.0}, {THICKNESS: 3.0}, {THICKNESS: 10.0}),
    solves=True,
)
