"""The probe was held at an angle to the skin's normal.

A rotation of the rigid probe about its own axes, up to 10 degrees. One edge touches first, so the force
starts low and catches up, and a moment appears. Depth counts from first touch, wherever the probe touches.
FEBio: the probe's shell is rotated before it is written.
Tell-tale: a left-right difference of the speeds; bone and face not parallel on the B-mode frame.
Source: Zheng, Mak & Lue 1999, J Rehabil Res Dev 36:71 (effect of misalignment on indentation).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.model import Array, LimbModel

_AROUND = 10.0  # margin around the probe (mm) within which the skin is considered
ABOUT_SHORT = Parameter("tilt_about_short_axis_deg", null=0.0, start=5.0, low=-15.0, high=15.0, typical=5.0,
                        prior="by hand, within 10 deg", both_sides=True,
                        reported="about_short_axis_deg")  # fmt: skip
ABOUT_LONG = Parameter("tilt_about_long_axis_deg", null=0.0, start=5.0, low=-15.0, high=15.0, typical=5.0,
                       prior="by hand, within 10 deg", both_sides=True,
                       reported="about_long_axis_deg")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Rotate the probe about an axis in its face, then move it along the beam until its gap to the skin is
    the same as before: on a round limb the lowered edge lies beside the highest point.

    Right-handed rotations: +5 deg about the short axis (y) lowers the side of +x, about the long one (x) that
    of -y.
    """
    return turned(model, (theta[ABOUT_LONG.name], theta[ABOUT_SHORT.name], 0.0))


def turned(model: LimbModel, degrees: tuple[float, float, float]) -> LimbModel:
    """The model with its probe rotated about x, y, z of its frame, at the same gap to the skin as before."""
    turn = np.deg2rad(degrees)
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return model
    axis = turn / angle
    body = model.bodies[0]
    nodes = model.mesh.nodes_of(body.blocks)
    center = np.array(body.center_of_mass)
    points = model.mesh.points.copy()
    arms = points[nodes] - center
    c, s = np.cos(angle), np.sin(angle)
    after = arms * c + np.cross(axis, arms) * s + np.outer(arms @ axis, axis) * (1 - c)
    lift = arms[:, 2].min() - after[:, 2].min()
    beside = _gap(model, center + after + [0.0, 0.0, lift]) - _gap(model, points[nodes])
    lift -= beside if np.isfinite(beside) else 0.0
    points[nodes] = center + after + [0.0, 0.0, lift]
    moved = replace(body, center_of_mass=(float(center[0]), float(center[1]), float(center[2] + lift)))
    bodies = (moved, *model.bodies[1:])
    info = {**model.info, "depth_offset_mm": float(model.info.get("depth_offset_mm", 0.0)) + float(lift)}
    return replace(model, mesh=replace(model.mesh, points=points), bodies=bodies, info=info)


def _gap(model: LimbModel, probe: Array) -> float:
    """Smallest height (mm) of the probe's points (n, 3) above the skin along the beam; NaN without skin."""
    surface = model.mesh.surfaces.get("skin")
    if surface is None:
        return float("nan")
    skin = model.mesh.points[np.unique(np.concatenate([each.ravel() for each in surface.facets.values()]))]
    reach = np.abs(probe[:, :2]).max() + _AROUND
    near = skin[np.all(np.abs(skin[:, :2]) < reach, axis=1)]
    if len(near) < 4:
        return float("nan")
    from scipy.interpolate import LinearNDInterpolator

    above = probe[:, 2] - LinearNDInterpolator(near[:, :2], near[:, 2])(probe[:, :2])
    return float(np.nanmin(above)) if np.isfinite(above).any() else float("nan")


EFFECT = Effect(
    name="tilt",
    sentence="the probe was held at an angle",
    kind="measurement",
    source="Zheng, Mak & Lue 1999, J Rehabil Res Dev 36:71",
    parameters=(ABOUT_SHORT, ABOUT_LONG),
    needs=("force", "map"),
    apply=apply,
    solves=True,
    new_mesh=True,
    each_time=True,
)
