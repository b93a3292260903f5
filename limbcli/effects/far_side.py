"""What the limb's far side rests on: unknown, and no column of a case states it.

A model's far side is free, as of a limb that hangs. A limb that lies on a bench, or in a hand, is held there:
its tissue cannot give way behind the bone, so that the force rises by 2 to 13 % (thirteen sites, a third of
the tissue deep), and speeds fall under the centre of the face and rise at its edges. The stiff limit: all
tissue beyond the bone is held, from a little behind its near surface on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.tissue import thickness
from limbcli.model import IntArray, LimbModel, Support

BEYOND = 10.0  # mm behind the bone's near surface, from which on tissue is held
_NODES = "far side"
HELD = Parameter("far_side_held", null=0.0, start=1.0, low=0.0, high=1.0, typical=1.0, prior="0 to 1")


def far_side(model: LimbModel) -> IntArray:
    """Nodes of the tissue that lie more than `BEYOND` behind the bone's near surface on the beam; where the
    beam meets no bone, behind the middle of the tissue."""
    nodes = model.mesh.solid_nodes
    height = model.mesh.points[nodes, 2]
    depth = thickness(model)
    bone = -depth if np.isfinite(depth) and depth > 0 else 0.5 * float(height.min())
    return np.asarray(nodes[height < bone - BEYOND])


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Hold the tissue of the far side."""
    nodes = far_side(model)
    if theta[HELD.name] < 0.5 or not len(nodes):
        return model
    mesh = replace(model.mesh, node_sets={**model.mesh.node_sets, _NODES: nodes})
    return replace(model, mesh=mesh, supports=(*model.supports, Support(_NODES, ("x", "y", "z"))))


FAR_SIDE = Effect(
    name="far-side",
    sentence="the limb's far side rests on something, or hangs more freely than assumed",
    kind="numerical",
    source="the stiff limit of what a limb rests on",
    parameters=(HELD,),
    apply=apply,
    solves=True,
)
