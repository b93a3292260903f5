"""Skin as a thin stiff layer over soft tissue.

The outer millimetres are c_skin / c times as stiff as the tissue below. Each cell is stiffened in proportion
to the fraction of its volume that lies in the layer, so the layer keeps its stiffness along the skin on any
mesh. Dermis is 5 to 300 times as stiff as what lies below, and 1 to 2 mm thick on the leg.
FEBio: element maps of c1, c2, cp.
Tell-tale: a wider dip beside the probe; speeds rise less near the surface and more at depth.
Source: Hendriks et al. 2003, Skin Res Technol 9:274 (skin and hypodermis under suction); Groves et al. 2013,
J Mech Behav Biomed Mater 18:167.
"""

from __future__ import annotations

import math

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta, same_model
from limbcli.effects.stiffness_places import Places
from limbcli.model import Array

THICKNESS = "skin_thickness_mm"


def skin_c_kpa(log_ratio: float, c_kpa: float) -> float:
    """c of the skin."""
    return math.exp(log_ratio) * c_kpa


STIFFNESS = Parameter("log_skin_ratio", null=0.0, start=1.5, low=0.0, high=6.0, typical=2.3,
                      prior="dermis 5 to 300 times as stiff as what lies below",
                      reported="c_kpa", turn=skin_c_kpa)  # fmt: skip


def stiffness(places: Places, theta: Theta) -> Array:
    """Stiffness factor at places; the parameter is ln(c_skin / c): 0 without skin, 2.3 for ten times as
    stiff."""
    inside = places.below_skin < theta.get(THICKNESS, 1.5)
    return np.asarray(1.0 + inside * np.expm1(theta[STIFFNESS.name]))


EFFECT = Effect(
    name="skin-layer",
    sentence="the skin is a thin layer much stiffer than what lies below",
    kind="tissue",
    source="Hendriks et al. 2003, Skin Res Technol 9:274",
    parameters=(STIFFNESS,),
    waves=same_model,
    stiffness=stiffness,
    grid=({THICKNESS: 1.5},),
    solves=True,
    spreads=True,
)
