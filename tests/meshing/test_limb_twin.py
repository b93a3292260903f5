"""Twin: a probe on the model of the whole limb gives the force of the site's own model."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.feb.settings import schedule
from limbcli.materials.ogden import ogden_type
from limbcli.meshing.frame import site_frame
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape
from limbcli.meshing.site_model import site_model
from limbcli.meshing.whole_limb import LimbMeshOptions, limb_mesh
from limbcli.model import Array, Domain, LimbModel, Mesh
from limbcli.model.bodies import Drive, RigidBody
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.limb_field.limb_force import under_probe
from tests.meshing.stump import quickly_meshed, stump

START, DEPTH = 0.05, 2.0
PROBE = ProbeShape(26.0, 9.0, 2.0)
BEHIND = (0.0, 40.0, 80.0)


def with_probe(mesh: Mesh, to_model: Array, bones: list[str], shape: ProbeShape = PROBE, **cuts) -> LimbModel:
    """A limb's mesh in a site's frame, with the probe at first touch, bones fixed and the cut held.

    to_model : (4, 4) from the limb's frame to the site's; cuts : of `under_probe`
    """
    held = [RigidBody(name, (0.0, 0.0, 0.0), (), (name,)) for name in bones]
    limb = LimbModel(
        mesh=mesh,
        materials={"tissue": ogden_type(c=0.008, f_kappa=10.0, m=2.0)},
        domains=(Domain("tissue", "tissue"),),
        bodies=tuple(held),
        drives=tuple(Drive(body.name, dof, "fixed") for body in held for dof in "xyzuvw"),  # type: ignore[arg-type]
    )
    return under_probe(limb, PlacedProbe(shape, to_model), **cuts)


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
