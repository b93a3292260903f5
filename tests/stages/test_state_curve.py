"""The common curve of a site's states: derivatives, closed forms of its speeds, and its twin for FEBio."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fitting.laws import LAWS
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import plan_of
from limbcli.inference.joint_fit import JointProblem, JointTask
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.shear_waves.speed import material_speeds
from limbcli.site_model.indentation_model import indentation_model
from limbcli.site_model.prestretch import StretchAxes, prestretched, skin_rise, through_depths
from limbcli.solvers.session import ReferenceSession
from tests.stages import block_case as block
from tests.stages import state_case

pytestmark = pytest.mark.slow

DEPTHS = [0.6, 1.4, 2.4]
THETA = np.array([60.0, 4.0, 0.9, 1.12])  # f_kappa, m, along, around


def built(c: float = state_case.C):
    return indentation_model(block.block_model(), schedule([1.0, 2.0]), c=c, f_kappa=100.0, m=2.0)


@pytest.fixture(scope="module")
def curve():
    made = StateCurve(
        built(),
        LAWS["ogden"],
        ("along", "around"),
        DEPTHS,
        c=state_case.C,
        density_kg_per_m3=1000.0,
    )
    yield made
    made.close()


def test_forces_have_exact_derivatives_by_law_and_stretches(curve):
    found, n = curve(THETA, (0, 1, 2, 3)), len(DEPTHS)
    for k in range(4):
        ends = []
        for step in (1e-3, -1e-3):
            moved = THETA.copy()
            moved[k] *= np.exp(step)
            ends.append(curve(moved).values[:n])
        rise = (ends[0] - ends[1]) / 2e-3 / THETA[k]
        # which of a flat skin's points lies highest may change within the step: 0.003 N of 0.35 N
        np.testing.assert_allclose(found.jacobian[:n, k], rise, rtol=2e-3, atol=0.015 * abs(rise).max())
    assert np.isnan(found.jacobian[n:]).all()


def test_speed_of_evenly_stretched_tissue_is_that_of_the_prestretched_law(curve):
    """Twin: the closed form of principal stretches, and the law with its prestrain at F = 1."""
    value, slopes = curve.even_speed(THETA)
    law = curve.tissue(THETA, c=state_case.C)
    speed = material_speeds(law, np.eye(3)[None], np.zeros(1, dtype=int), n_cells=1)
    assert value == pytest.approx(float(np.log(speed[0])), abs=1e-7)
    for k in range(4):
        up, down = THETA.copy(), THETA.copy()
        up[k], down[k] = THETA[k] * 1.001, THETA[k] / 1.001
        rise = (curve.even_speed(up)[0] - curve.even_speed(down)[0]) / (2 * np.log(1.001))
        assert slopes[k] == pytest.approx(rise, abs=1e-5)
    assert slopes[0] == 0.0  # no shear wave feels the bulk stiffness


def test_a_block_at_rest_is_evenly_stretched_but_for_its_compressibility(curve):
    """Held at base and sides under a flat skin."""
    assert curve(THETA).values[-1] == pytest.approx(1.0, abs=5e-3)
    assert curve(np.r_[THETA[:2], 1.0, 1.0]).values[-1] == pytest.approx(1.0, abs=1e-9)


def test_without_a_stretch_the_forces_are_those_of_the_plain_law(curve):
    """Twin: the indentation without any prestretch, through the same depths."""
    plain = indentation_model(block.block_model(), schedule(DEPTHS), c=state_case.C, f_kappa=60.0, m=4.0)
    with closing(ReferenceSession(plain, threads=1)) as session:
        wanted = session.solve().must_points.forces
    found = curve(np.r_[THETA[:2], 1.0, 1.0]).values[: len(DEPTHS)]
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_the_model_for_febio_reaches_the_same_levels(curve, tmp_path):
    """Twin: the probe waits clear of the skin, or, for FEBio, a little inside; what was written is read."""
    law, forces = curve.tissue(THETA, c=state_case.C), []
    for clear in (True, False):
        path = write_feb(
            through_depths(built(), DEPTHS, clear=clear).with_material("tissue", law), tmp_path / "state.feb"
        )
        with closing(ReferenceSession(read_feb(path), threads=1)) as session:
            points = session.solve().must_points
        np.testing.assert_allclose(points.depths[-len(DEPTHS) :], DEPTHS, atol=1e-9)
        forces.append(points.forces[-len(DEPTHS) :])
    assert 'type="prestrain elastic"' in path.read_text()
    assert '<prestrain type="prestrain gradient">' in path.read_text()
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-4)


def test_depths_count_from_where_the_stretched_skin_is_touched(curve):
    """Stretched both ways the skin rises and is met sooner: the same forces, at larger depths."""
    theta, depths = np.r_[THETA[:2], 1.12, 1.1], np.array(DEPTHS)
    model = through_depths(built(), DEPTHS).with_material("tissue", curve.tissue(theta, c=state_case.C))
    with closing(ReferenceSession(model, threads=1)) as session:
        found = session.solve(records=True)
    nodes = found.simulation.nodes["nodes.csv"]
    moved = np.stack([nodes.column(name)[0] for name in ("ux", "uy", "uz")], axis=1)
    rise, weights = skin_rise(model, nodes.items, moved)
    assert rise == pytest.approx(weights @ moved[:, 2], abs=1e-9)  # the skin is flat
    assert rise > 0.05
    forces = found.must_points.forces[1:]
    read = pchip_sample(np.r_[0.0, depths], np.r_[0.0, curve(theta).values[: len(depths)]], depths[:2] + rise)
    np.testing.assert_allclose(read.values, forces[:2], rtol=0.01)
    assert abs(curve(theta).values[1] / forces[1] - 1) > 0.03


def test_a_skin_that_sinks_out_of_reach_is_an_error_not_a_number(curve):
    """Compressible tissue that was shortened both ways gives way along z."""
    with pytest.raises(SolveError, match="the stretched skin recedes so far"):
        curve(np.array([0.5, 2.0, 0.75, 0.8]))


def test_what_holds_the_tissue_carries_the_probes_force(curve):
    """Forces of the prestretched tissue on base and sides, less those at rest, against the probe's."""
    model = through_depths(built(), DEPTHS).with_material("tissue", curve.tissue(THETA, c=state_case.C))
    analysis = Analysis(model, Settings(tolerance=1e-9, threads=1))
    try:
        snapshots = [each for each in analysis.run() if each.must]
        held = model.mesh.node_sets["fixed"]
        nodal = [analysis.system.internal(each.state)[0][held].sum(axis=0) for each in snapshots]
        probe = [each.forces.bodies[0, 2] for each in snapshots]
    finally:
        analysis.close()
    np.testing.assert_allclose(nodal[0], 0.0, atol=1e-8)  # at rest, though it is stressed
    reaction = np.array([each[2] for each in nodal])
    np.testing.assert_allclose(abs(reaction[1:]), np.abs(probe[1:]), rtol=1e-6)
    assert abs(reaction[-1]) > 1.0


def test_axes_turn_with_the_limb():
    axes = StretchAxes(np.array([0.6, 0.8, 0.0]), np.array([-0.8, 0.6, 0.0]))
    F = axes.gradient(1.2, 0.95)
    np.testing.assert_allclose(F @ axes.along, 1.2 * axes.along)
    np.testing.assert_allclose(F @ axes.around, 0.95 * axes.around)
    assert np.linalg.det(F) == pytest.approx(1.0)
    for way, (up, down) in {"along": ((1.2 * 1.001, 0.95), (1.2 / 1.001, 0.95)),
                            "around": ((1.2, 0.95 * 1.001), (1.2, 0.95 / 1.001))}.items():  # fmt: skip
        rise = (axes.gradient(*up) - axes.gradient(*down)) / (2 * np.log(1.001))
        np.testing.assert_allclose(axes.slope(1.2, 0.95, way), rise, atol=1e-6)
    assert prestretched(LAWS["ogden"].material(0.005, [50.0, 2.0]), F).law == "prestrain"


def test_residuals_of_states_have_the_slopes_of_their_differences(curve):
    """On the surrogate: c, the law's shape, both kinds of stretch, the gain."""
    reported = {"along": [0.9, 1.1], "around": [None, 1.0]}
    plan = plan_of(reported, {"around": 1.0}, ["a", "b"])
    memory, shape = SolvedPoints(curve), LAWS["ogden"].shape
    for theta in ([100, 2, 1, 1], [10, 2, 1, 1], [100, 4, 1, 1], [100, 2, 0.9, 1.02], [100, 2, 1.1, 1.05]):
        memory(np.array(theta, dtype=float), (0, 1, 2, 3))
    force = np.array([0.5, 1.5, 4.0])
    data = SiteMeasurement(
        "a", curve.depths, force, np.array([0.4, 0.8, 1.8]), 0.05, 0.1, np.r_[0.0, force],
        np.log([1.6, 1.7, 1.8, 2.0]), np.full(4, 0.03), 0.05,
    )  # fmt: skip
    task = JointTask([memory] * 2, [data] * 2, shape, state_case.C, states=plan, even_speed=curve.even_speed)
    values = np.array([each.start for each in plan.parameters])
    problem = JointProblem(task, [np.r_[state_case.C, 60.0, 3.0, values]])
    theta = np.array([1.1 * state_case.C, 60.0, 3.0, 1.02, 0.98, 1.04])
    residual = problem.objective()
    exact = residual(theta, True).jacobian
    for k in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[k], down[k] = theta[k] * (1 + 1e-5), theta[k] * (1 - 1e-5)
        rise = (residual(up, False).values - residual(down, False).values) / (2e-5 * theta[k])
        np.testing.assert_allclose(exact[:, k], rise, rtol=1e-3, atol=2e-4 * abs(rise).max(), err_msg=str(k))


def test_fibres_go_with_a_prestretch():
    """Stretched along them the tissue resists more than where they are slack; derivatives are exact."""
    law, theta = LAWS["fibres"], np.array([3.0, 1.0, 0.5, 1.1])  # m, fibre_shear, fibre_tension, along
    made = StateCurve(built(), law, ("along",), DEPTHS, c=state_case.C, density_kg_per_m3=1000.0)
    try:
        found, n = made(theta, (0, 1, 2, 3)), len(DEPTHS)
        for k in range(4):
            up, down = theta.copy(), theta.copy()
            up[k], down[k] = theta[k] * np.exp(1e-3), theta[k] * np.exp(-1e-3)
            rise = (made(up).values[:n] - made(down).values[:n]) / 2e-3 / theta[k]
            np.testing.assert_allclose(found.jacobian[:n, k], rise, rtol=5e-3, atol=0.015 * abs(rise).max())
        slack = made(np.r_[theta[:3], 0.9]).values[:n]
    finally:
        made.close()
    assert (found.values[:n] > 1.1 * slack).all()
    assert found.values[-1] == pytest.approx(1.0, abs=0.01)
