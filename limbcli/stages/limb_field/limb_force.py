"""The forces of the sites as the limb's own model gives them: a probe is set on it at every site.

Half-way to free cuts is an estimate of what a limb takes from the force of a site's model. Where the limb's
mesh is made for the probe, its own force is simulated instead, with the field's tissue, and the field is
conditioned anew on what is missing of the force that was read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
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
from limbcli.stages.limb_field.case_field import CaseField
from limbcli.stiffness_field import ForceReading, stiffness_field

_MOST_DEPTHS = 3
_ROUNDS, _SAME = 3, 0.01  # simulations of every site; how far off its force may be
_CUT_TOO_NEAR = 0.85  # limb's force over that of a site's model below which half-way to free cuts is a guess
_CONTRADICTED = 0.05  # how far the field's tissue may be from a force read without a warning
_TOLD = 0.02  # how far off it may be without a warning


def as_on_limb(
    found: CaseField, model_of: Callable[[CaseField], LimbModel], probes: Mapping[str, PlacedProbe],
    warnings: list[str], *, progress: Progress = SILENT,
) -> CaseField:  # fmt: skip
    """The field with whose tissue the limb's model gives the forces found at the sites.

    model_of : the limb with a field's tissue; probes : by the site's name
    warnings : gets a sentence for a site whose force cannot be simulated; it stays as it was
    """
    forces = {each.name: each.force for each in found.field.sites if each.force and each.name in probes}
    for number in range(_ROUNDS if forces else 0):
        model, on_limb = model_of(found), dict[str, float]()
        for name, force in list(forces.items()):
            progress.event("note", text=f"the limb under a probe at site {name}")
            try:
                forces[name], on_limb[name] = _simulated(
                    force, found.tissue_of(name), model, probes[name], progress=progress
                )
            except SolveError as error:
                del forces[name]
                warnings.append(
                    f"site {name}: the limb's force under the probe was not simulated ({error.what}); it is "
                    "estimated half-way to that of the site's model with free cuts"
                )
        found = replace(found, force_on_limb=on_limb)
        if number == _ROUNDS - 1 or all(abs(each - 1.0) < _SAME for each in on_limb.values()):
            break
        field = found.field
        sites = [replace(each, force=forces.get(each.name, each.force)) for each in field.sites]
        again = stiffness_field(field.limb, sites, field.maps, priors=field.priors)
        found = replace(found, field=again)
    warnings += [_off(*each) for each in found.force_on_limb.items() if abs(each[1] - 1.0) > _TOLD]
    return found


def cut_warnings(found: CaseField) -> list[str]:
    """Sentences on sites whose cuts take so much of their force that the limb's is a guess."""
    return [
        f"site {site.name}: the force on the limb is taken as {100 * least:.0f} % of that in the site's "
        "model, half-way to free cuts: its cuts are too near the probe. Mesh it with a larger --margin-mm "
        "and fit again, or give --site-size-mm, which simulates the limb's force"
        for site in found.field.sites
        if site.force is not None and site.name not in found.force_on_limb
        and (least := float(site.force.limb_over_site.min())) < _CUT_TOO_NEAR
    ]  # fmt: skip


def contradicting_forces(found: CaseField) -> list[str]:
    """Sentences on sites whose force the field's tissue does not give."""
    ratios = {
        each.name: each.force.ratio(found.tissue_of(each.name))
        for each in found.field.sites if each.force is not None
    }  # fmt: skip
    return [
        f"site {name}: the field's tissue gives {100 * ratio:.0f} % of the force found there: other "
        "sites, or its own wave speed, contradict it"
        for name, ratio in ratios.items() if abs(ratio - 1.0) > _CONTRADICTED
    ]  # fmt: skip


def _off(name: str, ratio: float) -> str:
    return (
        f"site {name}: the limb's force under the probe is {100 * ratio:.0f} % of that found: the site's "
        "model is too unlike the limb's (its mesh, or cuts too near the probe). Mesh it with a larger "
        "--margin-mm or as tet10, and fit again"
    )


def _simulated(
    force: ForceReading, tissue: Array, limb: LimbModel, probe: PlacedProbe, *, progress: Progress
) -> tuple[ForceReading, float]:
    """The reading with the limb's simulated force over that of the site's model, and its ratio to the force
    read at the deepest level.

    tissue : ln of c, m, f_kappa (3,) of the limb at the site
    """
    depths = _some(force.depths)
    on_limb = limb_forces(limb, probe, depths, penalty=force.contact_penalty, progress=progress)
    order = np.argsort(force.depths, kind="stable")
    of_site = np.interp(depths, force.depths[order], force.predict(tissue)[0][order])
    ratio = np.exp(np.interp(force.depths, depths, np.log(on_limb) - of_site))
    deepest = int(np.argmax(force.depths))
    return replace(force, limb_over_site=ratio), float(on_limb[-1] / force.fitted[deepest])


def _some(depths: Array) -> Array:
    """A few of the depths, increasing, the deepest among them."""
    unlike = np.unique(depths)
    n = min(_MOST_DEPTHS, len(unlike))
    return np.asarray(unlike[np.linspace(len(unlike) - 1, 0, n + 1).round().astype(int)[:n]][::-1])


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
