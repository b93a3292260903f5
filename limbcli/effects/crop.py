"""The model is cut too close to the probe, or held too firmly at its cut.

A side fixed 10 mm from the face doubles the force, 20 mm adds a quarter, 40 mm a few per cent. A bound that
needs no new mesh: with the cut free instead of fixed the force is too low, so the truth lies between the two,
and their difference is the size of the uncertainty.
Tell-tale: too stiff, and increasingly so at large depth; deep speeds low, superficial ones high.
Source: Saint-Venant's principle; Hayes et al. 1972, J Biomech 5:541 for the layer without sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.model import LimbModel

LIMB_POSITION = 0.5  # position of a limb between a fixed (0) and a free (1) cut
FREED = Parameter("cut_freed", null=0.0, start=1.0, low=0.0, high=1.0, typical=1.0, prior="0 or 1")


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Free the cut: only the bone stays fixed."""
    sets = model.mesh.node_sets
    if theta[FREED.name] < 0.5 or "cut" not in sets or "bone" not in sets or not len(sets["bone"]):
        return model
    alone = np.setdiff1d(sets["cut"], sets["bone"])
    held = np.setdiff1d(sets["fixed"], alone)
    mesh = replace(model.mesh, node_sets={**sets, "held": held})
    supports = tuple(
        replace(each, node_set="held") if each.node_set == "fixed" else each for each in model.supports
    )
    return replace(model, mesh=mesh, supports=supports)


EFFECT = Effect(
    name="crop",
    sentence="the model ends too near the probe, or is held too firmly where it was cut",
    kind="numerical",
    source="Hayes et al. 1972, J Biomech 5:541",
    parameters=(FREED,),
    apply=apply,
    solves=True,
)
