"""The pose of a limb, its mirror image and the order of nodes and triangles do not change what is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from limbcli.feb.settings import schedule
from limbcli.fitting.numerical_error import gain_deviation
from limbcli.meshing.frame import SiteFrame, site_frame
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array
from limbcli.site_model.indentation_model import indentation_model
from limbcli.site_model.mesh_checks import across_warnings
from limbcli.solvers.session import ReferenceSession
from tests.stages.test_mesh import prism

PROBE, PLACE, AXIS = ProbeShape(30.0, 12.0, 2.0), np.array([5.0, 28.6, 5.3]), np.array([1.0, 0.0, 0.0])
F_KAPPA, DEPTHS = 20.0, [1.0, 2.0, 4.0]


def turned(angles: tuple[float, float, float]) -> Array:
    return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).as_matrix())


POSES: dict[str, tuple[Array, int | None]] = {
    "along y": (turned((90.0, 0.0, 0.0)), None),
    "about z": (turned((0.0, 0.0, 37.0)), None),
    "any": (turned((50.0, -20.0, 110.0)), None),
    "mirror image": (np.diag([-1.0, 1.0, 1.0]), None),
    "upside down and mirrored": (np.diag([1.0, 1.0, -1.0]), None),
    "other order": (np.eye(3), 7),
}


def posed(turn: Array, seed: int | None = None) -> Limb:
    """An oval, tapering limb, turned (also mirrored), its points and triangles in another order."""
    bodies = []
    for body in (prism(30.0, -60, 60), prism(9.0, -70, 70, x=4.0)):
        points, faces = body.points * [1.0, 0.93, 1.0], body.faces
        points[:, :2] *= 1 + 0.002 * points[:, 2:]
        if np.linalg.det(turn) < 0:
            faces = faces[:, ::-1]
        if seed is not None:
            rng = np.random.default_rng(seed)
            order = rng.permutation(len(points))
            points, faces = points[order], np.argsort(order)[faces]
            faces = np.roll(faces[rng.permutation(len(faces))], 1, axis=1)
        bodies.append(Triangles(points @ turn.T, faces))
    return mend(bodies[0], bodies[1:], where="test")


def frame_of(limb: Limb, turn: Array) -> SiteFrame:
    axis = turn @ AXIS
    return site_frame(limb, turn @ PLACE, (axis[0], axis[1], axis[2]), PROBE)


@pytest.mark.parametrize(("turn", "seed"), POSES.values(), ids=POSES)
def test_a_site_s_frame_turns_with_the_limb(turn: Array, seed: int | None) -> None:
    plain, found = frame_of(posed(np.eye(3)), np.eye(3)), frame_of(posed(turn, seed), turn)
    np.testing.assert_allclose(found.skin_point, turn @ plain.skin_point, atol=1e-6)
    np.testing.assert_allclose(found.normal, turn @ plain.normal, atol=1e-6)
    np.testing.assert_allclose(found.long_axis, turn @ plain.long_axis, atol=1e-6)
    lowered = (each.to_model[2] @ np.append(each.skin_point, 1.0) for each in (plain, found))
    assert next(lowered) == pytest.approx(next(lowered), abs=1e-6)
    assert abs(found.proximal @ (turn @ plain.proximal)) == pytest.approx(1.0, abs=1e-6)


def forces(element: str, turn: Array, seed: int | None) -> tuple[Array, float]:
    axis = turn @ AXIS
    x, y, z = turn @ PLACE
    options = MeshOptions(element=element, margin=20.0, sizes=Sizes(under_probe=5.0, far=8.0))
    made = site_model(posed(turn, seed), (x, y, z), (axis[0], axis[1], axis[2]), PROBE, options)
    model = indentation_model(made.model, schedule(DEPTHS), c=0.005, f_kappa=F_KAPPA, m=2.0)
    session = ReferenceSession(model)
    try:
        return session.solve().must_points.forces, gain_deviation(model, None, f_kappa=F_KAPPA)
    finally:
        session.close()


@pytest.mark.slow
@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_the_force_changes_with_the_pose_by_less_than_the_stated_mesh_error(element: str) -> None:
    """Forces change because each pose is meshed anew: up to 10 % (tet4, 1 mm deep), 2 % (tet10)."""
    plain, error = forces(element, np.eye(3), None)
    for name in ("any", "mirror image", "other order")[: 3 if element == "tet4" else 1]:  # of the same meshes
        found, other = forces(element, *POSES[name])
        assert np.abs(np.log(found / plain)).max() < max(error, other), name


def test_a_limb_that_lies_across_has_no_known_proximal_end() -> None:
    assert not across_warnings(np.array([0.1, -0.3, 0.95]), "axial")
    assert not across_warnings(np.array([0.0, 1.0, 0.05]), (1.0, 0.0, 0.0))
    (said,) = across_warnings(np.array([0.0, 1.0, 0.05]), "transverse")
    assert "3 degrees" in said


@pytest.mark.slow
def test_c_and_m_change_with_the_pose_by_less_than_the_stated_mesh_error(tmp_path: Path) -> None:
    """A reading of one mesh, fitted on that of the turned limb; next to no noise of the reading is stated.
    On its own mesh a fit would give back the truth. Of the intervals of three poses that of m misses it in
    this one, by 0.5 % of m (figures/meshing.md): within a tenth of its width."""
    from tests.benchmarks.poses import SHAPE, C, change, fitted, model_of, reading_of

    sizes = Sizes(under_probe=5.0, far=8.0)  # at 6 and 10 mm tet4 errs by more: figures/meshing.md
    reading = reading_of(model_of(None, "tet4", sizes))
    found = fitted(model_of("any", "tet4", sizes), *reading, tmp_path)
    truth = {"c_kpa": {"value": 1000 * C}, "m": {"value": SHAPE[1]}}
    for name in truth:
        moved, low, high = change(found, {"parameters": truth}, name)
        spare = 0.1 * (high - low)
        assert low - spare < 0.0 < high + spare, name
        assert low <= moved <= high
