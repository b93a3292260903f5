"""A tapered sleeve around a bone is donned and loaded: forces in balance, pressure and shear."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tubes import LENGTH, OUTER, tube

from limbcli.errors import CaseError, MeshError, SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.contacts.contact_points import N_STATE, NORMAL, TRACTION
from limbcli.fem.motion.load_curves import value
from limbcli.meshing.surfaces import Triangles
from limbcli.model import LimbModel, LogRecord, Support
from limbcli.progress import SILENT, Progress
from limbcli.sockets import donning
from limbcli.sockets.donning import FACE, SOCKET, DonningOptions, don_and_load, for_febio, socket_model
from limbcli.sockets.knee import KneeLoad
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.reference import prepare

OPTIONS = DonningOptions(
    loads_n=(0.5, 1.0), donning_steps=6, load_steps=2, penalty=20.0, search_radius_mm=8.0
)
TAPER = 0.1


def limb() -> LimbModel:
    """A tube whose inner wall is held, as on a bone, tapered by 1 in 10 towards z = 0."""
    model = tube(1.0, n=(4, 16, 3))
    n = int(model.mesh.block("tissue").cells.max()) + 1
    points = model.mesh.points[:n].copy()
    radius = np.hypot(points[:, 0], points[:, 1])
    share = (radius - radius.min()) / np.ptp(radius)
    points[:, :2] *= (1 + share * TAPER * (points[:, 2] - 0.5 * LENGTH) / OUTER)[:, None]
    mesh = replace(
        model.mesh,
        points=points,
        blocks=(model.mesh.block("tissue"),),
        node_sets={"bone": model.mesh.node_sets["bone"]},
        surfaces={"skin": model.mesh.surfaces["skin"]},
    )
    return replace(
        model, mesh=mesh, bodies=(), drives=(), contacts=(), curves={},
        supports=(Support("bone", ("x", "y", "z")),),
    )  # fmt: skip


def face(tight: float = 0.8, n: int = 48) -> Triangles:
    """A conical sleeve, smaller than the limb by `tight` (mm), with its normals inward."""
    z = np.linspace(-0.5 * LENGTH, 1.5 * LENGTH, 9)
    angle = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    T, Z = np.meshgrid(angle, z)
    R = OUTER - tight + TAPER * (Z - 0.5 * LENGTH)
    points = np.stack([R * np.cos(T), R * np.sin(T), Z], axis=-1).reshape(-1, 3)
    k = np.arange(n)
    after = (k + 1) % n
    faces = []
    for row in range(len(z) - 1):
        a, b = row * n + k, row * n + after
        faces += [np.stack([a, b + n, b], axis=1), np.stack([a, a + n, b + n], axis=1)]
    return Triangles(points, np.concatenate(faces).astype(np.int64))


def test_a_limb_is_donned_and_loaded_in_balance() -> None:
    result = don_and_load(limb(), face(), OPTIONS, threads=1)
    assert [state.load_n for state in result.states] == [0.0, 0.5, 1.0]
    donned, low, high = result.states
    assert len(donned.pressure_mpa) == len(result.skin_nodes) == 16 * 4
    assert (donned.pressure_mpa > 0).mean() > 0.9
    for state, load in ((low, 0.5), (high, 1.0)):
        np.testing.assert_allclose(state.socket_force_n[2], load, rtol=1e-4)
        assert state.imbalance_n < 1e-4 * max(load, float(np.linalg.norm(state.socket_force_n)))
        assert (state.shear_mpa <= 0.3 * state.pressure_mpa * 1.2 + 1e-6).all()
    assert [each.aim for each in result.balance] == [
        *("donned 17 %", "donned 33 %", "donned 50 %", "donned 67 %", "donned 83 %", "donned 100 %"),
        *("50 % of the way to 0.5 N", "load 0.5 N", "50 % of the way to 1 N", "load 1 N"),
    ]
    assert 0.0 < result.worst.share < 1e-4, result.balance
    # the force drives the narrowing sleeve onto the limb
    assert high.socket_shift_mm[2] > low.socket_shift_mm[2]
    assert high.strain.max() > 0.0


def test_a_socket_of_the_skins_own_shape_is_donned_without_a_force_and_loaded() -> None:
    """The 16 corners of the sleeve are those of the limb: nothing overlaps, all touches."""
    options = replace(OPTIONS, loads_n=(0.5,), donning_steps=2)
    result = don_and_load(limb(), face(0.0, n=16), options, threads=1)
    donned, loaded = result.states
    assert 0.0 < result.balance[1].contact_n < 1e-6
    assert np.linalg.norm(donned.socket_force_n) < 1e-6
    assert loaded.socket_force_n[2] == pytest.approx(0.5, rel=1e-4)
    assert result.worst.share < 1e-4, result.balance


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_augmented_contact_leaves_no_more_penetration_than_was_asked(friction: float) -> None:
    quick = replace(OPTIONS, loads_n=(0.5,), friction=friction)
    soft = don_and_load(limb(), face(), quick, threads=1)
    hard = don_and_load(limb(), face(), replace(quick, penetration_mm=0.015), threads=1)
    assert min(state.penetration_mm for state in soft.states) > 0.02
    for state in hard.states:
        assert state.penetration_mm <= 0.015
        size = max(state.load_n, float(np.linalg.norm(state.socket_force_n)))
        assert state.imbalance_n < 1e-4 * size
    assert hard.states[-1].socket_force_n[2] == pytest.approx(0.5, rel=1e-4)
    # the wall's whole displacement presses more than what the penalty leaves of it
    pressed = [
        float((s.facet_pressure_mpa * s.facet_area_mm2).sum()) for s in (soft.states[0], hard.states[0])
    ]
    assert 1.0 < pressed[1] / pressed[0] < 1.2


@pytest.mark.slow
@pytest.mark.parametrize(("n_done", "penetration_mm"), [(4, None), (8, None), (8, 0.015)])
def test_an_interrupted_run_goes_on_where_it_stopped(n_done, penetration_mm, tmp_path: Path) -> None:
    """While donning, and under load; with friction, whose path it remembers. The multipliers of augmented
    contact are found again."""
    options, keep, steps, reached = replace(OPTIONS, penetration_mm=penetration_mm), tmp_path / "work", [], []

    def listen(kind: str, facts: dict) -> None:
        if kind == "newton":
            steps.append((facts["step"], facts["iteration"]))
            if stops and facts["step"] > n_done:
                raise KeyboardInterrupt
        elif kind == "note":
            reached.append(facts["text"])

    stops = True
    with pytest.raises(KeyboardInterrupt):
        don_and_load(limb(), face(), options, threads=1, keep=keep, progress=Progress(listen))
    stops, steps = False, []
    found = don_and_load(limb(), face(), options, threads=1, keep=keep, progress=Progress(listen))
    assert reached == [f"starting from {n_done} load steps that are already solved"]
    if penetration_mm is None:
        assert {k for step, k in steps if step <= n_done} == {0}, "known steps are in equilibrium"
    whole = don_and_load(limb(), face(), options, threads=1)
    for ours, theirs in zip(found.states, whole.states, strict=True):
        assert ours.pressure_mpa == pytest.approx(theirs.pressure_mpa, rel=1e-2, abs=1e-5)
    assert not keep.exists()


def test_without_friction_fewer_steps_say_what_they_lead_to() -> None:
    told: list[str] = []
    listener = Progress(lambda kind, facts: told.append(facts["aim"]) if kind == "newton" else None)
    options = replace(OPTIONS, loads_n=(0.5,), friction=0.0)
    result = don_and_load(limb(), face(), options, threads=1, progress=listener)
    assert [each.aim for each in result.balance][-1] == told[-1] == "load 0.5 N"
    assert "donned 100 %" in told


def test_a_loose_solve_leaves_forces_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the solver leaves at free nodes is no force from outside: the balance sees it."""
    loosely = partial(donning.prepare, tolerance=0.03, stalled=0.03)
    monkeypatch.setattr(donning, "prepare", loosely)
    quick = replace(OPTIONS, loads_n=(0.5,), friction=0.1)
    assert don_and_load(limb(), face(), quick, threads=1).worst.share > 1e-4


@pytest.mark.slow
def test_friction_over_a_penetration_is_no_moment_left_over() -> None:
    """It acts on the skin at one point and on the wall at another: the couple of both is counted."""
    knee = KneeLoad((1.0, 0.0, 30.0), (0.05, -0.02, 0.0), (-0.5, 0.3, 0.0))
    soft = replace(OPTIONS, donning_steps=3, loads_n=(0.5,), friction=0.1, penalty=3.0, knee=knee)
    result = don_and_load(limb(), face(), soft, threads=1)
    assert result.states[-1].penetration_mm > 0.05
    assert result.worst.share < 1e-5, result.balance


def test_what_holds_the_donned_socket_passes_over_into_the_first_load() -> None:
    """Let go at once, the limb would spring back: a limb with a liner then found no equilibrium."""
    knee = KneeLoad((1.0, 0.0, 30.0), (0.05, -0.02, 0.0), (-0.5, 0.3, 0.0))
    options = replace(OPTIONS, loads_n=(0.5,), load_steps=4, penetration_mm=0.02, knee=knee)
    found = don_and_load(limb(), face(), options, threads=1)
    donned, loading = found.states[0], found.model.steps[1]

    def applied(dof: str, time: float) -> float:
        drives = [each for each in loading.drives if each.dof == dof and each.kind in ("force", "moment")]
        return sum(each.value * value(found.model.curves[each.curve], time) for each in drives)

    held = (*donned.socket_force_n, *donned.socket_moment_n_mm[:2])
    assert [applied(dof, 1.0) for dof in "xyzuv"] == pytest.approx(held, abs=1e-12)
    assert [applied(dof, 2.0) for dof in "xyz"] == pytest.approx((0.05, -0.02, 0.5), abs=1e-12)
    about = found.states[1].moment_about(np.array([1.0, 0.0, 30.0]))
    np.testing.assert_allclose(about[:2], [-0.5, 0.3], atol=0.02)


def test_a_facet_that_touches_in_part_bears_its_pressure_on_its_whole_current_area() -> None:
    """As FEBio logs it: the mean over the points, of which one of three touches; the other facet is free."""
    state = np.zeros((2, 3, N_STATE))
    state[0, 1, TRACTION] = 0.03
    state[0, 1, NORMAL + 2] = 20.0  # twice the current area
    patch = SimpleNamespace(weights=np.full(3, 1 / 6), areas=np.array([9.0, 8.0]), facets=np.zeros((2, 3)))
    area, pressure, _ = donning.tractions(patch, state)  # type: ignore[arg-type]
    np.testing.assert_allclose(area, [10.0, 8.0])
    np.testing.assert_allclose(pressure, [0.01, 0.0])


@pytest.mark.parametrize(("penetration_mm", "n"), [(None, 2), (0.015, 8)])
def test_augmented_contact_takes_every_time_step_as_febio_does(penetration_mm: float | None, n: int) -> None:
    """Each raises the multipliers: with one donning step, facets of tet4 differed from FEBio's by 14 %."""
    options = replace(OPTIONS, loads_n=(0.5,), friction=0.0, penetration_mm=penetration_mm)
    assert sum(map(len, prepare(socket_model(limb(), face(), options), threads=1).times())) == n


# FEBio 4.11.0 (tag v4.11, built from source) on the files of `socket_model` below: mean pressure (kPa) of the
# three rings of facets from the narrow end up, after donning and under 0.5 N.
FEBIO = {0.0: ((2.8379, 2.2135, 1.5463), (5.0940, 3.9273, 2.6730)),
         0.3: ((2.8040, 2.2400, 1.7238), (3.4459, 2.2258, 1.2884))}  # fmt: skip


def as_febio_was_given(friction: float) -> DonningOptions:
    fine = {"donning_steps": 24, "load_steps": 8} if friction else {}
    return replace(OPTIONS, friction=friction, penetration_mm=0.015, loads_n=(0.5,), **fine)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "as_febio", "field"), [(0.0, False, 0.001), (0.3, False, 0.055), (0.3, True, 0.003)]
)
def test_donning_and_load_agree_with_febio(friction: float, as_febio: bool, field: float) -> None:
    """FEBio holds sticking skin anew where a step's first iterate ends; the reference solver does so only
    if asked. With friction that is nearly all of the difference."""
    options = replace(as_febio_was_given(friction), slip_as_febio=as_febio)
    found = don_and_load(limb(), face(), options, threads=1)
    for state, expected in zip(found.states, FEBIO[friction], strict=True):
        rings = 1e3 * state.facet_pressure_mpa.reshape(16, 3).mean(axis=0)
        rms = np.sqrt(((rings - expected) ** 2).mean() / np.square(expected).mean())
        assert rms < field
        assert rings.sum() == pytest.approx(sum(expected), rel=0.7 * field)


# The same of FEBio 4.11.0 on the files of `for_febio`: penalty alone, half of 24 and 8 load steps.
FEBIO_PENALTY = ((2.7398, 2.1542, 1.8156), (3.3791, 2.1599, 1.2871))


def test_febio_finds_the_pressures_of_the_penalty_in_half_of_the_load_steps() -> None:
    """It forgets shear twice in each step. With as many steps as ours its field differs by 3.2 %."""
    options = replace(OPTIONS, donning_steps=24, load_steps=8, loads_n=(0.5,))
    found = don_and_load(limb(), face(), options, threads=1)
    for state, expected in zip(found.states, FEBIO_PENALTY, strict=True):
        rings = 1e3 * state.facet_pressure_mpa.reshape(16, 3).mean(axis=0)
        np.testing.assert_allclose(rings, expected, rtol=0.01)
    donning, loading = for_febio(found.model).steps
    assert (donning.n_steps, loading.n_steps) == (12, 4)
    assert (donning.must_points, loading.must_points) == ((1.0,), (1.0,))


@pytest.mark.parametrize(
    ("changes", "n_steps"),
    [
        ({"donning_steps": 5, "load_steps": 3, "loads_n": (0.5, 1.0)}, [3, 4]),
        ({"friction": 0.0}, [6, 6]),
        ({"penetration_mm": 0.02}, [6, 6]),
        ({"donning_steps": 1, "loads_n": ()}, [1]),
    ],
)
def test_load_steps_for_febio(changes: dict, n_steps: list[int]) -> None:
    options = replace(OPTIONS, **{"donning_steps": 6, "load_steps": 6, "loads_n": (0.5,), **changes})
    steps = for_febio(socket_model(limb(), face(), options)).steps
    assert [step.n_steps for step in steps] == n_steps
    assert [step.n_steps * step.step_size for step in steps] == pytest.approx(
        [1.0, len(options.loads_n)][: len(steps)]
    )


@pytest.mark.skipif(not FebioSolver().found(), reason="needs FEBio 4: set LIMBCLI_FEBIO to its binary")
def test_febio_completes_donning_and_load_with_friction(tmp_path: Path) -> None:
    model = don_and_load(limb(), face(), as_febio_was_given(0.3), threads=1).model
    model = replace(model, records=(LogRecord("rigid_body", ("Fz",), "force.txt", SOCKET),))
    FebioSolver().run(write_feb(model, tmp_path / "socket.feb"), progress=SILENT)
    last = (tmp_path / "force.txt").read_text().split()[-1]
    assert float(last.split(",")[-1]) == pytest.approx(0.5, rel=0.01)


def test_febio_takes_the_time_steps_of_the_model_however_often_it_augments() -> None:
    """With opt_iter 25 FEBio 4.11 took 7 steps for 5: the iterations of 2 augmentations are more."""
    model = socket_model(limb(), face(), replace(OPTIONS, penetration_mm=0.015))
    most = int(model.contacts[0].more["maxaug"]) * int(model.steps[0].control["max_refs"])
    assert all(step.opt_iterations > most for step in model.steps)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_febio_is_asked_for_an_unsymmetric_matrix(friction: float) -> None:
    """With a symmetric one FEBio 4.11 failed in the step after donning: augmented, without friction."""
    model = socket_model(limb(), face(), replace(OPTIONS, friction=friction, penetration_mm=0.015))
    assert [step.control["symmetric_stiffness"] for step in model.steps] == ["non-symmetric"] * 2
    assert not model.contacts[0].symmetric


def test_shear_and_moment_at_the_knee_are_borne() -> None:
    knee = KneeLoad((1.0, 0.0, 30.0), (0.05, -0.02, 0.0), (-0.5, 0.3, 0.0))
    options = replace(OPTIONS, loads_n=(0.5,), load_steps=4, penetration_mm=0.02, knee=knee)
    result = don_and_load(limb(), face(), options, threads=1)
    _, loaded = result.states
    np.testing.assert_allclose(loaded.socket_force_n, [0.05, -0.02, 0.5], atol=1e-4)
    # the moment is that of dead loads at the socket's centre: it shifts by 0.02 mm
    about = loaded.moment_about(np.array([1.0, 0.0, 30.0]))
    np.testing.assert_allclose(about[:2], [-0.5, 0.3], atol=0.02)
    assert np.abs(loaded.socket_shift_mm[:2]).max() > 1e-3
    assert loaded.imbalance_n < 1e-4
    assert result.worst.share < 1e-4, result.balance


def test_a_load_that_nothing_holds_says_what_it_was() -> None:
    pulled_off = replace(OPTIONS, loads_n=(40.0,), donning_steps=4, load_steps=1, sign=-1.0)
    with pytest.raises(SolveError, match="the load of 40 N has no equilibrium") as caught:
        don_and_load(limb(), face(), pulled_off, threads=1)
    assert "out of it" in caught.value.fix


@pytest.mark.slow
def test_a_failure_under_a_load_says_up_to_which_time_there_is_a_solution() -> None:
    """The force on the socket falls from that of donning, so that it does not tell how far the load came."""
    pulled_off = replace(OPTIONS, loads_n=(3.0,), donning_steps=4, load_steps=1, sign=-1.0)
    with pytest.raises(SolveError, match=r"there is a solution up to time 1\.\d+, force"):
        don_and_load(limb(), face(), pulled_off, threads=1)


def test_a_socket_that_touches_nowhere_says_so() -> None:
    with pytest.raises(MeshError, match="touches the skin nowhere") as caught:
        don_and_load(limb(), face(tight=-1.0), replace(OPTIONS, donning_steps=1, friction=0.0), threads=1)
    assert "from a file" in caught.value.fix, "which has no all_mm"


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    model = socket_model(limb(), face(), replace(OPTIONS, penetration_mm=0.05))
    don = read_feb(write_feb(model, tmp_path / "socket.feb"))
    assert don.contacts == model.contacts
    assert don.steps == model.steps
    assert don.mesh.surfaces[FACE].n_facets == len(face().faces)
    np.testing.assert_array_equal(don.mesh.points, model.mesh.points)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (replace(OPTIONS, skin="hide"), "no surface 'hide'"),
        (replace(OPTIONS, friction=-0.1), "friction is below 0"),
        (replace(OPTIONS, loads_n=(400.0, -1.0)), "does not press"),
        (replace(OPTIONS, donning_steps=0), "no step"),
        (replace(OPTIONS, penetration_mm=0.0), "penetration of 0 mm"),
        (replace(OPTIONS, sign=2.0), "neither 1 nor -1"),
    ],
)
def test_options_out_of_range_have_their_own_messages(options: DonningOptions, words: str) -> None:
    with pytest.raises(CaseError, match=words):
        socket_model(limb(), face(), options)


def test_a_limb_in_a_socket_is_not_put_into_another() -> None:
    model = socket_model(limb(), face(), OPTIONS)
    with pytest.raises(CaseError, match="already holds"):
        socket_model(model, face(), OPTIONS)
    assert SOCKET in {body.name for body in model.bodies}
