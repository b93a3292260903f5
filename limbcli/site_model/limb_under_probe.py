"""A probe on the model of the whole limb, at a site that its mesh was made for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.feb.settings import USUAL_PENALTY, schedule
from limbcli.meshing.crop import within
from limbcli.meshing.mending import Plane
from limbcli.meshing.probe import PlacedProbe, probe_mesh
from limbcli.meshing.regions import reachable
from limbcli.meshing.whole_limb import HELD
from limbcli.model import Array, Block, LimbModel, Mesh, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.progress import SILENT, Progress
from limbcli.site_model.indentation_model import (
    PROBE,
    TISSUE,
    indentation_model,
    starting_depth,
    with_penalty,
)
from limbcli.solvers.session import ReferenceSession

_START = 0.05  # mm, how deep the probe begins
_TIPS, _SKIN, _FACE = "probe_tips", "contact", "probe_face"


def under_probe(limb: LimbModel, probe: PlacedProbe, *, cuts: tuple[Plane, ...] = ()) -> LimbModel:
    """The limb in the frame of a probe's site, with the probe at first touch.

    limb : with fixed bones and its cut held
    cuts : planes of the site's frame beyond which the limb is held too, as the site's model is at its cuts
    """
    mesh = limb.mesh
    points = mesh.points @ probe.to_site[:3, :3].T + probe.to_site[:3, 3]
    rigid, first = probe_mesh(probe.shape), len(points)
    ((kind, facets),) = mesh.surfaces["skin"].facets.items()
    near = reachable(points, facets[:, :3], probe.shape)
    face = {"quad4": rigid.quads + first, "tri3": rigid.tips + first}
    blocks = (*mesh.blocks, Block(PROBE, "quad4", face["quad4"]), Block(_TIPS, "tri3", face["tri3"]))
    surfaces = {_SKIN: Surface(_SKIN, {kind: facets[near]}), _FACE: Surface(_FACE, face)}
    of_bones = [mesh.node_sets[name] for body in limb.bodies for name in body.node_sets]
    beyond = np.flatnonzero(np.logical_not(within(points, cuts, slack=0.0)))
    held = np.union1d(mesh.node_sets[HELD], np.setdiff1d(beyond, np.concatenate(of_bones)))
    whole = Mesh(
        np.vstack([points, rigid.points - [0, 0, _START]]), blocks, {**mesh.node_sets, HELD: held}, surfaces
    )
    own = tuple(Drive(PROBE, dof, "fixed") for dof in ("x", "y", "u", "v", "w"))  # type: ignore[arg-type]
    return replace(
        limb,
        mesh=whole,
        bodies=(RigidBody(PROBE, (0.0, 0.0, -_START), (PROBE, _TIPS)), *limb.bodies),
        supports=(Support(HELD, ("x", "y", "z")),),
        drives=(*limb.drives, *own),
        contacts=(Contact(_SKIN, _FACE),),
    )


def limb_forces(
    limb: LimbModel, probe: PlacedProbe, depths: Array, *, penalty: float = USUAL_PENALTY,
    progress: Progress = SILENT,
) -> Array:  # fmt: skip
    """Forces (n,) N of the limb, with the laws that it has, under a probe at increasing depths (n,) mm.

    penalty : of its contact, as a multiple of the tissue's stiffness at rest

    Raises SolveError if the model cannot be solved.
    """
    placed = under_probe(limb, probe)
    plan = schedule(depths.tolist(), start=starting_depth(placed, float(depths[0])))
    ready = indentation_model(placed, plan, c=1.0, f_kappa=1.0, m=2.0)  # its law is replaced by the limb's
    ready = with_penalty(ready.with_material(TISSUE, limb.materials[TISSUE]), penalty)
    session = ReferenceSession(ready, progress=progress)
    try:
        return session.solve().must_points.forces
    finally:
        session.close()
