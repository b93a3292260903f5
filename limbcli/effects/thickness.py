"""The tissue between skin and bone is thicker or thinner than in the model.

z -> (1 + e) z of the tissue below first touch, with e within 20 % (posture, swelling since the MRI, voxel
size). Stiffness and speed over depth scale as 1/H.
FEBio: the mesh's nodes are moved.
Tell-tale: the skin-bone distance of the first B-mode frame, which is measured directly.
Source: Hayes et al. 1972, J Biomech 5:541 (stiffness of a layer over its thickness).
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.model import LimbModel

SCALE = Parameter("thickness_change", null=0.0, start=0.05, low=-0.2, high=0.2, typical=0.1,
                  prior="posture and volume: within 10 %", reported="epsilon")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Scale the heights of the tissue's nodes about first touch; the probe stays in place."""
    change = theta[SCALE.name]
    if change == 0.0:
        return model
    nodes = model.mesh.solid_nodes
    points = model.mesh.points.copy()
    points[nodes, 2] *= 1.0 + change
    return replace(model, mesh=replace(model.mesh, points=points))


EFFECT = Effect(
    name="thickness",
    sentence="the tissue is thicker or thinner than in the model",
    kind="measurement",
    source="Hayes et al. 1972, J Biomech 5:541",
    parameters=(SCALE,),
    apply=apply,
    solves=True,
    new_mesh=True,
)
