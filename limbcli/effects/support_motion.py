"""The limb support is compliant: the bone moves under the load.

Depth is the decrease of the skin-bone distance, so a rigid displacement along the beam does not appear in it;
the probe's absolute travel is longer by F/k, k 5 to 100 N/mm.
FEBio: the bone as a rigid body on a spring to ground.
Tell-tale: probe travel minus depth grows with the force. Invisible without the travel.
Source: series compliance (Hooke); Pathak et al. 1998, IEEE Trans Rehabil Eng 6:12 (indentor and limb motion).
"""

from __future__ import annotations

import math
from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta, adds_to
from limbcli.model import LimbModel
from limbcli.model.bodies import Drive, RigidBody, Spring


def stiffness_n_per_mm(compliance: float, c_kpa: float) -> float:
    """Of the support."""
    return 1.0 / compliance if compliance > 0 else math.inf


COMPLIANCE = Parameter("support_compliance_mm_per_n", null=0.0, start=0.03, low=0.0, high=0.35, typical=0.05,
                       prior="5 to 100 N/mm", reported="k_n_per_mm", turn=stiffness_n_per_mm)  # fmt: skip
_LENGTH = 50.0
_DOFS = ("x", "y", "u", "v", "w")


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Attach all fixed nodes to a rigid bone that is held along z by a spring."""
    compliance = theta[COMPLIANCE.name]
    if compliance == 0.0:
        return model
    low = float(model.mesh.points[model.mesh.node_sets["fixed"], 2].min())
    bone = RigidBody("bone", (0.0, 0.0, low), node_sets=("fixed",))
    ground = RigidBody("ground", (0.0, 0.0, low - _LENGTH))
    spring = Spring(
        "support", "ground", "bone", 1.0 / compliance, (0.0, 0.0, low - _LENGTH), (0.0, 0.0, low), _LENGTH
    )
    drives = [Drive("bone", dof, "fixed") for dof in _DOFS]  # type: ignore[arg-type]
    drives += [Drive("ground", dof, "fixed") for dof in (*_DOFS, "z")]  # type: ignore[arg-type]
    return replace(
        model,
        supports=tuple(each for each in model.supports if each.node_set != "fixed"),
        bodies=(*model.bodies, bone, ground),
        springs=(*model.springs, spring),
        drives=(*model.drives, *drives),
    )


EFFECT = Effect(
    name="support-motion",
    sentence="limb and bone move under the load",
    kind="measurement",
    source="Pathak et al. 1998, IEEE Trans Rehabil Eng 6:12",
    parameters=(COMPLIANCE,),
    needs=("travel",),
    apply=apply,
    observe=adds_to("compliance", COMPLIANCE),
)
