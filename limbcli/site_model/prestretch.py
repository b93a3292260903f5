"""A site's model in a state: the tissue is prestretched, and in equilibrium before the probe touches it.

Layers of skin and fat are stretched with the tissue, and are unloaded when the tissue is.

The elastic law is evaluated at F_e = F F_pre, the deformation gradient of the mesh times the stretch that the
tissue had when the mesh was made. F_pre is uniform and isochoric:

    F_pre = l_along a (x) a + l_around t (x) t + 1 / (l_along l_around) z (x) z

with a along the limb, t around it, z outward at the site. It is applied by a load curve while the probe is
clear of the skin; the tissue reaches equilibrium between bone, cut planes and the free skin, and then the
probe moves down.

Source: Johnson and Hoger 1995, J Elasticity 41:177 (split); Maas et al. 2016, J Mech Behav
Biomed Mater 61:499 ("prestrain elastic" of FEBio, which is what `feb` writes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from limbcli.effects.tissue import limb_axis
from limbcli.feb.settings import FIRST_STEP_S, SECONDS_PER_MM, schedule, whole_steps
from limbcli.model import Array, Curve, Curved, IntArray, LimbModel, Material
from limbcli.site_model.indentation_model import TISSUE, TRAVEL, start_at, starting_depth, touched_first
from limbcli.site_model.site_layers import held_layers

RAMP = "prestretch"  # name of the load curve of the prestretch
CLEAR_MM = 5.0  # mm, height of the probe above first touch while the prestretch is applied
_RAMP_S = 0.2
WAYS = ("along", "around")


@dataclass(frozen=True, eq=False)
class StretchAxes:
    """along, around (3,): unit vectors in the skin's plane at the site."""

    along: Array
    around: Array

    @staticmethod
    def of(model: LimbModel) -> StretchAxes:
        along = np.array(limb_axis(model))
        return StretchAxes(along, np.cross([0.0, 0.0, 1.0], along))

    def gradient(self, along: float, around: float) -> Array:
        """F_pre (3, 3) for these stretches.

        >>> axes = StretchAxes(np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0]))
        >>> np.diag(axes.gradient(1.25, 1.0))
        array([1.  , 1.25, 0.8 ])
        """
        out = np.outer([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]) / (along * around)
        out += along * np.outer(self.along, self.along) + around * np.outer(self.around, self.around)
        return np.asarray(out)

    def slope(self, along: float, around: float, way: str) -> Array:
        """d F_pre / d ln stretch (3, 3), for the stretch of direction `way`."""
        axis, stretch = (self.along, along) if way == "along" else (self.around, around)
        out = stretch * np.outer(axis, axis)
        out[2, 2] -= 1.0 / (along * around)
        return np.asarray(out)


def prestretched(law: Material, gradient: Array) -> Material:
    """The law with F_pre (3, 3), applied by the load curve `RAMP`."""
    numbers = tuple(float(each) for each in np.ravel(gradient))
    return Material("prestrain", {"ramp": Curved(1.0, RAMP), "F0": numbers}, (law,), law.density)


def with_layers_stretched(model: LimbModel, gradient: Array) -> LimbModel:
    """The model with its layers of skin and fat prestretched by F_pre (3, 3)."""
    for name in held_layers(model):
        model = model.with_material(name, prestretched(model.materials[name], gradient))
    return model


def through_depths(model: LimbModel, depths: list[float], *, clear: bool = True) -> LimbModel:
    """The built model, loaded first by the prestretch and then by the probe through these depths (mm).

    clear : the probe waits above the skin, and the first level is the tissue at rest. Otherwise it waits at
        its initial depth, slightly below first touch, with which FEBio converges, and all levels are under
        load. As the tissue is elastic and slides freely, the loaded levels are the same.
    """
    start = -CLEAR_MM if clear else starting_depth(model, depths[0])
    plan = schedule(depths)
    wait = _RAMP_S + (SECONDS_PER_MM * CLEAR_MM if clear else 0.0)
    times = [round(wait + each, 3) for each in plan.times]
    n_steps = whole_steps(times[-1])
    times[-1] = n_steps * FIRST_STEP_S
    travel = [depth - start for depth in plan.depths]
    curves = {
        **model.curves,
        TRAVEL: Curve(((0.0, 0.0), (_RAMP_S, 0.0), *zip(times, travel, strict=True))),
        RAMP: Curve(((0.0, 0.0), (_RAMP_S, 1.0))),
    }
    must_points = (_RAMP_S, *times) if clear else tuple(times)
    step = replace(model.steps[0], n_steps=n_steps, must_points=must_points, dt_max_curve=None)
    return replace(start_at(model, start), curves=curves, steps=(step,))


def in_state(model: LimbModel, depths: list[float], *, along: float, around: float) -> LimbModel:
    """The built model with its tissue stretched: one level at rest, then indentation to these depths (mm)."""
    gradient = StretchAxes.of(model).gradient(along, around)
    stretched = with_layers_stretched(model, gradient)
    law = prestretched(model.materials[TISSUE], gradient)
    return through_depths(stretched.with_material(TISSUE, law), depths)


def with_nodes_moved(model: LimbModel, nodes: IntArray, displacement: Array) -> LimbModel:
    """The model with nodes (n,) moved by the displacement (n, 3), mm."""
    points = model.mesh.points.copy()
    points[nodes] += displacement
    return replace(model, mesh=replace(model.mesh, points=points))


def skin_rise(model: LimbModel, nodes: IntArray, displacement: Array) -> tuple[float, Array]:
    """Rise (mm) of the height of first touch when nodes (n,) move by the displacement (n, 3), mm.

    Also the derivatives (n,) of the rise by the nodes' z displacements; only the three nodes of the facet
    that is touched first contribute.
    """
    moved = with_nodes_moved(model, nodes, displacement)
    points = moved.mesh.points
    (corners, share), (before, before_share) = touched_first(moved), touched_first(model)
    weights = np.zeros(len(model.mesh.points))
    weights[corners] = share
    rise = weights @ points[:, 2] - before_share @ model.mesh.points[before, 2]
    return float(rise), weights[nodes]
