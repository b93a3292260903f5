"""A region of other stiffness: a scar, fibrosis, a stiff band next to the bone.

c(X) = c exp(a) in a ball of 7 mm at one of several places under the probe, or in the 5 mm next to
the bone.
FEBio: element maps of c1, c2, cp.
Tell-tale: seen in the map at rest, at the same place at every load; the force moves little.
Source: Bramley et al. 2021, Ann Biomed Eng 49:3176 (residual-limb tissue is patchy);
element-wise c from a speed map, as in Oddes & Solav 2023.
"""

from __future__ import annotations

import numpy as np

from limbcli.effects.base import Effect, Parameter, Theta
from limbcli.effects.tissue import centroids, scaled, tissue_block
from limbcli.model import Array, LimbModel

X, DEPTH, NEAR_BONE = "inclusion_x_mm", "inclusion_depth_mm", "near_bone_mm"
RADIUS_MM, EDGE_MM = 7.0, 1.5
CONTRAST = Parameter("log_inclusion_ratio", null=0.0, start=0.7, low=-1.6, high=3.0, typical=1.0,
                     prior="scars 2 to 10 times as stiff")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    contrast = theta[CONTRAST.name]
    if contrast == 0.0:
        return model
    if theta.get(NEAR_BONE, 0.0) > 0.0:
        inside = _near_bone(model, theta[NEAR_BONE])
    else:
        place = np.array([theta.get(X, 0.0), 0.0, -theta.get(DEPTH, 10.0)])
        inside = _soft_step(RADIUS_MM - np.linalg.norm(centroids(model) - place, axis=1))
    return scaled(model, np.exp(contrast * inside))


def _soft_step(distance: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(distance / EDGE_MM, -40, 40))))


def _near_bone(model: LimbModel, reach: float) -> Array:
    from scipy.spatial import cKDTree

    nodes = model.mesh.node_sets.get("bone", model.mesh.node_sets.get("fixed"))
    if nodes is None or not len(nodes):
        return np.zeros(len(tissue_block(model).cells))
    distance, _ = cKDTree(model.mesh.points[nodes]).query(centroids(model))
    return _soft_step(reach - distance)


EFFECT = Effect(
    name="inclusion",
    sentence="a region (scar, fibrosis, near the bone) is stiffer or softer than the rest",
    kind="tissue",
    source="Bramley et al. 2021, Ann Biomed Eng 49:3176",
    parameters=(CONTRAST,),
    apply=apply,
    grid=(
        {X: 0.0, DEPTH: 8.0},
        {X: -9.0, DEPTH: 10.0},
        {X: 9.0, DEPTH: 10.0},
        {X: 0.0, DEPTH: 18.0},
        {NEAR_BONE: 5.0},
    ),
    solves=True,
    tell_tale="a spot in the speed map at every load, there at rest already",
)
