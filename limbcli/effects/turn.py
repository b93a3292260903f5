"""The direction of the probe's long side, where a case names it: across the limb, or along it.

"transverse" and "axial" are meant by eye, along the limb's axis as it seems. Where a bone lies near the end
of the face, a few degrees about the beam decide whether it is met. A vector is taken as measured.
Source: Zheng, Mak & Lue 1999, J Rehabil Res Dev 36:71 (angles of a hand-held indenter).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.tilt import ABOUT_LONG, turned
from limbcli.model import LimbModel

ABOUT_BEAM = Parameter("turn_about_beam_deg", null=0.0, start=ABOUT_LONG.typical, low=-15.0, high=15.0,
                       typical=ABOUT_LONG.typical, prior="by eye, as a tilt by hand")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Rotate the probe about the beam."""
    return turned(model, (0.0, 0.0, theta[ABOUT_BEAM.name]))


TURN = Effect(
    name="turn",
    sentence="the probe was turned about the beam",
    kind="numerical",
    source="Zheng, Mak & Lue 1999, J Rehabil Res Dev 36:71",
    parameters=(ABOUT_BEAM,),
    apply=apply,
    solves=True,
)
