"""Twin: a probe on the model of the whole limb gives the force of the site's own model."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.feb.settings import schedule
from limbcli.materials.ogden import ogden_type
from limbcli.meshing.crop import within
from limbcli.meshing.frame import site_frame
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import Plane, mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape, probe_mesh
from limbcli.meshing.regions import reachable
from limbcli.meshing.site_model import site_model
from limbcli.meshing.whole_limb import HELD, LimbMeshOptions, limb_mesh
from limbcli.model import Array, Block, Domain, LimbModel, Mesh, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.session import ReferenceSession
from tests.meshing.stump import quickly_meshed, stump

START, DEPTH = 0.05, 2.0
PROBE = ProbeShape(26.0, 9.0, 2.0)
BEHIND = (0.0, 40.0, 80.0)


def with_probe(
    mesh: Mesh, to_model: Array, bones: list[str], shape: ProbeShape = PROBE, cuts: tuple[Plane, ...] = ()
) -> LimbModel:
    """A limb's mesh in a site's frame, with the probe at first touch, bones fixed and the cut held.

    to_model : (4, 4) from the limb's frame to the site's
    cuts : planes beyond which the limb is held too, as the site's model is at its cuts
    """
    points = mesh.points @ to_model[:3, :3].T + to_model[:3, 3]
    rigid, first = probe_mesh(shape), len(points)
    of_bones = np.concatenate([mesh.node_sets[name] for name in bones])
    ((kind, facets),) = mesh.surfaces["skin"].facets.items()
    near = reachable(points, facets[:, :3], shape)
    probe = {"quad4": rigid.quads + first, "tri3": rigid.tips + first}
    blocks = (
        *mesh.blocks,
        Block("probe", "quad4", probe["quad4"]),
        Block("probe_tips", "tri3", probe["tri3"]),
    )
    surfaces = {
        "contact": Surface("contact", {kind: facets[near]}),
        "probe_face": Surface("probe_face", probe),
    }
    beyond = np.flatnonzero(~within(points, cuts, slack=0.0))
    sets = {**mesh.node_sets, HELD: np.union1d(mesh.node_sets[HELD], np.setdiff1d(beyond, of_bones))}
    whole = Mesh(np.vstack([points, rigid.points - [0, 0, START]]), blocks, sets, surfaces)
    held = [RigidBody(name, (0.0, 0.0, 0.0), (), (name,)) for name in bones]
    fixed = [(body.name, dof) for body in held for dof in "xyzuvw"] + [("probe", dof) for dof in "xyuvw"]
    return LimbModel(
        mesh=whole,
        materials={"tissue": ogden_type(c=0.008, f_kappa=10.0, m=2.0)},
        domains=(Domain("tissue", "tissue"),),
        bodies=(RigidBody("probe", (0.0, 0.0, -START), ("probe", "probe_tips")), *held),
        supports=(Support(HELD, ("x", "y", "z")),),
        drives=tuple(Drive(name, dof, "fixed") for name, dof in fixed),  # type: ignore[arg-type]
        contacts=(Contact("contact", "probe_face"),),
    )


def force(model: LimbModel) -> float:
    plan = schedule([DEPTH], start=START)
    session = ReferenceSession(indentation_model(model, plan, c=0.008, f_kappa=10.0, m=2.0), body="probe")
    try:
        return float(session.solve().must_points.forces[-1])
    finally:
        session.close()


@pytest.mark.slow
def test_the_whole_limb_under_a_probe_gives_the_force_of_the_site_model(monkeypatch):
    """Behind a stump, at the default sizes. Held where the site's model is cut, the limb differs by the two
    meshes' errors (about 0.5 %), else by the limb that gives way beyond the cuts, too (1.4 %)."""
    surfaces = stump()
    skin = surfaces.pop("skin")
    limb = mend(skin, list(surfaces.values()))
    frame = site_frame(limb, np.array(BEHIND), "axial", PROBE)
    local = site_model(limb, BEHIND, "axial", PROBE)
    quickly_meshed(monkeypatch)
    options = LimbMeshOptions(nodes=20_000, probes=(PlacedProbe(PROBE, frame.to_model),))
    mesh = limb_mesh(limb, surfaces, limb_frame(limb, "left"), options).mesh
    wanted = force(local.model)
    held = with_probe(mesh, frame.to_model, list(surfaces), PROBE, cuts=local.domain.planes)
    assert force(held) == pytest.approx(wanted, rel=0.01)
    assert force(with_probe(mesh, frame.to_model, list(surfaces))) == pytest.approx(wanted, rel=0.02)
