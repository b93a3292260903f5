"""What every effect promises, and the golden models where they hold the same effect."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Delaunay

import limbcli.effects
from limbcli.effects import EFFECTS, effect
from limbcli.effects.curves import Curves
from limbcli.effects.depth_zero import TOUCHES
from limbcli.effects.drainage import Drainage
from limbcli.effects.effect import Effect, Parameter
from limbcli.effects.reading import Protocol, Reading, read
from limbcli.effects.tissue import core
from limbcli.effects.turn import TURN
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.model import Block, ElementMap, LimbModel, Mesh, Surface
from limbcli.model.bodies import RigidBody

FOLDER = Path(limbcli.effects.__file__).parent
NAMES = [each.name for each in EFFECTS]


@pytest.fixture(scope="module")
def base(golden: Path):
    return read_feb(golden / "effect-base" / "model.feb")


def same(a: object, b: object) -> bool:
    """Equal to the last bit, arrays and dataclasses included."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(np.asarray(a), np.asarray(b))
    if is_dataclass(a) and is_dataclass(b):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def test_every_effect_of_the_catalogue_is_there():
    numerical = {"locking", "crop", "contact"}
    measurement = {
        "force-zero",
        "force-gain",
        "depth-zero",
        "depth-gain",
        "tilt",
        "support-motion",
        "thickness",
    }
    tissue = {"anisotropy", "skin-layer", "adipose-layer", "inclusion", "viscoelasticity", "poroelasticity"}
    tissue |= {"nonlinearity", "preload", "contraction", "friction"}
    swe = {"swe-time-scale", "swe-guided-wave", "swe-depth-bias"}
    by_kind = {kind: {e.name for e in EFFECTS if e.kind == kind} for kind in ("numerical", "swe")}
    assert set(NAMES) == numerical | measurement | tissue | swe, "list the effect above, by its kind"
    assert by_kind == {"numerical": numerical, "swe": swe}
    assert len(NAMES) == len(set(NAMES))


@pytest.mark.parametrize("each", EFFECTS, ids=NAMES)
def test_name_source_and_bounds(each: Effect):
    module = FOLDER / f"{each.name.replace('-', '_')}.py"
    assert module.is_file()
    text = module.read_text(encoding="utf-8")
    for line in ("Source:", "Tell-tale:"):
        assert line in text, f"the docstring of {module.name} needs a line that begins with {line}"
    assert each.source
    for p in each.parameters:
        assert p.low <= p.null <= p.high
        assert p.low <= p.start <= p.high
        assert p.shape or p.start != p.null
        assert p.low <= p.typical <= p.high


@pytest.mark.parametrize(
    "each", [pytest.param(e, id=e.name, marks=[pytest.mark.slow] * (e.name == "tilt")) for e in EFFECTS]
)
def test_null_is_the_base_and_the_input_stays(each: Effect, base):
    before = {"materials": dict(base.materials), "points": base.mesh.points.copy(), "steps": base.steps}
    for point in each.grid:
        assert same(each.apply(base, {**each.null, **point}), base)
        assert each.observe(Reading(), {**each.null, **point}) == Reading()
        each.apply(base, {**each.start, **point})
    assert same(dict(base.materials), before["materials"])
    assert same(base.mesh.points, before["points"])
    assert base.steps == before["steps"]


@pytest.mark.parametrize("each", EFFECTS, ids=NAMES)
def test_start_changes_model_or_reading(each: Effect, base, golden):
    model = read_feb(golden / "effect-base-tet4" / "model.feb") if each.name == "locking" else base
    changed = each.apply(model, each.start) is not model or each.observe(Reading(), each.start) != Reading()
    assert changed or each.name == "crop"  # a block without a cut has nothing to set free


@pytest.mark.parametrize("each", [e for e in EFFECTS if e.solves], ids=lambda e: e.name)
def test_febio_model_is_read_back_as_written(each: Effect, base, tmp_path):
    model = each.apply(base, each.start)
    back = read_feb(write_feb(model, tmp_path / "model.feb"))
    assert same(back.materials["tissue"], model.materials["tissue"])
    assert np.array_equal(back.mesh.points, model.mesh.points)
    assert back.contacts[0].friction == model.contacts[0].friction
    assert back.contacts[0].penalty == model.contacts[0].penalty


def test_a_field_of_stiffness_alone_is_applied_to_the_model(base):
    ratio = Parameter("own_ratio", null=1.0, start=2.0, low=1.0, high=4.0, typical=2.0)
    own = Effect(
        "own", "all of it is stiffer", "tissue", "no source", parameters=(ratio,),
        stiffness=lambda places, theta: np.full(places.at.shape[:-1], theta["own_ratio"]),
    )  # fmt: skip
    assert own.apply(base, own.null) is base
    before, after = (each.materials["tissue"].parameters["c1"] for each in (base, own.apply(base, own.start)))
    assert after.values == pytest.approx(2.0 * before)


# ---------------------------------------------------------------- against the golden models


def test_fibres_are_those_of_the_golden_model(base, golden):
    model = effect("anisotropy").apply(base, {"fibre_shear_per_c": 0.8, "fibre_tension_per_c": 0.6})
    mine = model.materials["tissue"].parts[1].parameters
    theirs = read_feb(golden / "effect-fibre" / "model.feb").materials["tissue"].parts[1].parameters
    for name in ("ksi", "mu", "alpha", "beta", "lam0"):
        assert mine[name] == pytest.approx(theirs[name])
    assert mine["fiber"] == theirs["fiber"]


def test_skin_has_the_golden_volume_and_stiffness(golden, base):
    """The map's share of each cell, times volume, is the volume of a layer of that thickness."""
    from limbcli.effects.stiffness_places import layer_share
    from limbcli.solvers.integration_points import IntegrationPoints

    share = layer_share(base, 1.5)
    corners = base.mesh.surfaces["skin"].facets["tri6"][:, :3].ravel()
    top = np.ptp(base.mesh.points[corners][:, :2], axis=0)
    volume = IntegrationPoints.of(base.mesh.points, base.mesh.solid_blocks[0]).volume.sum(axis=1)
    assert share @ volume == pytest.approx(np.prod(top) * 1.5, rel=0.06)
    theta = {"log_skin_ratio": np.log(0.15 / 0.005), "skin_thickness_mm": 1.5}
    stiff = effect("skin-layer").apply(base, theta).materials["tissue"].parameters["c1"]
    assert isinstance(stiff, ElementMap)
    layers = read_feb(golden / "effect-skin" / "model.feb").materials
    assert stiff.values.max() == pytest.approx(layers["skin"].parameters["c1"])
    assert stiff.values.min() == pytest.approx(layers["tissue"].parameters["c1"])


def test_friction_is_that_of_the_golden_model(base, golden):
    theirs = read_feb(golden / "effect-friction" / "model.feb")
    model = effect("friction").apply(base, {"friction_coefficient": 0.3})
    assert model.contacts[0].friction == theirs.contacts[0].friction
    assert model.contacts[0].symmetric == theirs.contacts[0].symmetric
    assert model.contacts[0].knmult == theirs.contacts[0].knmult


def test_bone_spring_is_that_of_the_golden_model(base, golden):
    theirs = read_feb(golden / "effect-bone-spring" / "model.feb")
    model = effect("support-motion").apply(base, {"support_compliance_mm_per_n": 0.5})
    assert model.springs[0].stiffness == theirs.springs[0].stiffness == 2.0
    assert {b.name for b in model.bodies} == {b.name for b in theirs.bodies}
    assert next(b for b in model.bodies if b.name == "bone").node_sets == ("fixed",)
    held = [{each.node_set for each in every.supports} for every in (base, model)]
    assert held[1] == held[0] - {"fixed"}  # the bone is held by the spring alone


def test_promoted_tet4_is_the_golden_tet10(base, golden):
    linear = read_feb(golden / "effect-base-tet4" / "model.feb")
    mended = effect("locking").apply(linear, {"quadratic_elements": 1.0})
    block, theirs = mended.mesh.solid_blocks[0], base.mesh.solid_blocks[0]
    assert block.kind == "tet10"
    assert block.cells.shape == theirs.cells.shape
    mine = mended.mesh.points[block.cells].mean(axis=(0, 1))
    assert mine == pytest.approx(base.mesh.points[theirs.cells].mean(axis=(0, 1)), abs=1e-9)
    assert len(mended.mesh.node_sets["fixed"]) == len(base.mesh.node_sets["fixed"])


def test_relaxing_force_follows_febio(golden):
    """Hereditary integral of the elastic curve against FEBio's viscoelastic run: peak and end of the hold."""
    table = np.loadtxt(golden / "effect-base" / "rigid_body.csv", delimiter=",", comments="*")
    depth, force = -table[:, 3], -table[:, 9]
    curves = Curves(np.r_[0.0, depth], np.r_[0.0, force], np.zeros((len(depth) + 1, 0)), np.zeros(0))
    prony = ((0.4, 0.8), (0.25, 15.0))
    for hold, expected in ((0.0, 0.44448), (30.0, 0.34149)):
        steps = np.linspace(0.5, 5.0, 10)  # the ramp of 4 s in ten pieces
        protocol = Protocol(np.zeros(10), steps, np.r_[np.zeros(9), hold], ramp=0.4)
        found = read(curves, protocol, Reading(prony=prony)).force[-1]
        assert found == pytest.approx(expected, rel=0.04)


# ---------------------------------------------------------------- readings


def _line() -> Curves:
    depth = np.linspace(0, 10, 11)
    return Curves(depth, 2 * depth, np.log(2 + 0.1 * depth)[:, None], np.array([13.0]), 30.0)


def _protocol() -> Protocol:
    return Protocol(np.array([0.0, 4.0, 8.0]), np.array([0.0, 2.0, 4.0]), np.full(3, 20.0))


@pytest.mark.parametrize(
    ("name", "theta", "force", "speed"),
    [
        ("force-zero", {"force_zero_n": 1.5}, [1.5, 5.5, 9.5], [2.0, 2.2, 2.4]),
        ("force-gain", {"force_gain": 1.1}, [0.0, 4.4, 8.8], [2.0, 2.2, 2.4]),
        ("depth-zero", {"depth_zero_mm": 1.0}, [2.0, 6.0, 10.0], [2.1, 2.3, 2.5]),
        ("depth-zero", {"depth_zero_mm": 1.0, TOUCHES: 1.0}, [0.0, 6.0, 10.0], [2.0, 2.3, 2.5]),
        ("depth-gain", {"depth_gain": 1.05}, [0.0, 4.2, 8.4], [2.0, 2.21, 2.42]),
        ("preload", {"preload_n": 2.0}, [0.0, 4.0, 8.0], [2.1, 2.3, 2.5]),
        ("swe-time-scale", {"swe_modulus_scale": 0.64}, [0.0, 4.0, 8.0], [2.5, 2.75, 3.0]),
    ],
)
def test_readings_by_hand(name, theta, force, speed):
    shown = read(_line(), _protocol(), effect(name).observe(Reading(), theta))
    assert shown.force == pytest.approx(force, abs=1e-6)
    assert np.exp(shown.log_speed[:, 0]) == pytest.approx(speed, abs=1e-3)


def test_what_relaxes_and_drains_starts_from_a_preload_at_rest():
    """Force and depth are 0 where both were set to zero, and a level's force is the sum of its parts by hand:
    4 N on top of the preload, of which 0.3 remembers a ramp of 1 s and a hold of 2 s."""
    drainage = Drainage(np.array([1.0, 8.0]), np.array([[0.2], [0.2]]), np.array([5.0]))
    protocol = Protocol(np.zeros(2), np.array([0.0, 2.0]), np.array([2.0, 2.0]))
    kept = 10.0 * -np.expm1(-0.1) * np.exp(-0.2)
    relaxing = read(_line(), protocol, Reading(preload=2.0, prony=((0.3, 10.0),))).force
    assert relaxing == pytest.approx([0.0, 4.0 * (1 + 0.3 * kept)], abs=1e-9)
    slow = 100.0 * -np.expm1(-0.01) * np.exp(-0.02)  # of 5 mm^2 at 0.05 mm^2/s
    draining = read(_line(), protocol, Reading(preload=2.0, draining=((drainage, 0.05),))).force
    assert draining == pytest.approx([0.0, 6.0 * (1 - 0.2 * (1 - slow * 2 / 3)) - 2.0 * 0.8], abs=1e-9)


def test_the_travel_is_the_way_that_the_probe_took_whatever_the_depth_reads():
    """A speed of sound that shows too little depth shortens the depth, not the guide's travel."""
    for name, theta, travel in (
        ("depth-gain", {"depth_gain": 1.05}, [0.0, 2.1, 4.2]),
        ("depth-zero", {"depth_zero_mm": 1.0}, [0.0, 2.0, 4.0]),
        ("depth-zero", {"depth_zero_mm": 1.0, TOUCHES: 1.0}, [0.0, 3.0, 5.0]),
        ("preload", {"preload_n": 2.0}, [0.0, 2.0, 4.0]),
        ("support-motion", {"support_compliance_mm_per_n": 0.1}, [0.0, 2.4, 4.8]),
    ):
        shown = read(_line(), _protocol(), effect(name).observe(Reading(), theta))
        assert shown.travel == pytest.approx(travel)


@pytest.mark.parametrize(("depth_zero", "first"), [(0.0, 30.0), (1.0, 28.95)])
def test_a_wrong_speed_of_sound_scales_the_distance_to_the_bone_as_it_scales_the_depth(depth_zero, first):
    """30 mm of which the probe has pressed 1.05 * zero; the image shows 1/1.05 of it."""
    shown = read(_line(), _protocol(), Reading(depth_gain=1.05, depth_zero=depth_zero))
    assert shown.thickness == pytest.approx(first / 1.05)


def test_guided_waves_gain_most_where_the_tissue_is_thin():
    reading = effect("swe-guided-wave").observe(Reading(), {"guided_1e4_per_hz2": 0.25})
    gain = read(_line(), _protocol(), reading).log_speed - read(_line(), _protocol(), Reading()).log_speed
    expected = -0.5 * np.log1p(-((2000.0 / (2 * 30.0 * 200.0)) ** 2))  # v 2 m/s, h 30 mm, f 200 Hz
    assert gain[0, 0] == pytest.approx(expected, rel=1e-9)
    assert np.all(np.diff(gain[:, 0]) > 0)


def test_a_loss_of_speed_with_depth_is_counted_from_where_the_scanner_reads_right():
    """2 % per mm, windows 2 mm above and 8 mm below that depth: 4 % more and 16 % less at any load."""
    depth = np.linspace(0.0, 10.0, 3)
    curves = Curves(depth, 2 * depth, np.log(np.full((3, 2), 3.0)), np.array([10.0, 20.0]), 30.0)
    theta = {"swe_loss_per_mm": 0.02, "swe_reads_right_at_mm": 12.0}
    shown = read(curves, _protocol(), effect("swe-depth-bias").observe(Reading(), theta))
    assert np.exp(shown.log_speed) == pytest.approx(np.tile([3.12, 2.52], (3, 1)))


def test_a_thicker_layer_reaches_deeper_below_the_same_skin(base):
    """By as much as is said, of the tissue alone: the probe is where it was."""
    thicker = effect("thickness").apply(base, {"thickness_change": 0.1})
    nodes = np.unique(base.mesh.solid_blocks[0].cells)
    probe = np.setdiff1d(np.arange(len(base.mesh.points)), nodes)
    assert thicker.mesh.points[nodes, 2].min() == pytest.approx(1.1 * base.mesh.points[nodes, 2].min())
    assert np.array_equal(thicker.mesh.points[nodes, :2], base.mesh.points[nodes, :2])
    assert np.array_equal(thicker.mesh.points[probe], base.mesh.points[probe])


def test_a_soft_contact_has_its_share_of_the_penalty(base):
    softer = effect("contact").apply(base, {"penalty_factor": 0.25})
    assert [c.penalty / b.penalty for c, b in zip(softer.contacts, base.contacts, strict=True)] == [0.25]


@pytest.mark.parametrize("q", [0.0, 0.8, 1.0])
def test_unequal_weights_bend_the_law_by_m_times_their_difference_and_keep_its_ground_modulus(q, base):
    """Of an energy sum c/m^2 (sum of stretches^m - 3), slope and bend at rest go as sum c and sum c m; a
    second pair has as much of either exponent and bends nothing."""
    before = core(base.materials["tissue"]).parameters
    for share in (0.0, 0.3):
        theta = {"weight_q": q, "second_pair_share": share, "second_exponent": 14.0}
        law = core(effect("nonlinearity").apply(base, theta).materials["tissue"]).parameters
        terms = [(law[f"c{k}"], law[f"m{k}"]) for k in range(1, 7) if f"c{k}" in law]
        assert sum(c for c, _ in terms) == pytest.approx(before["c1"] + before["c2"])
        bend = (1 - share) * (before["c1"] + before["c2"]) * before["m1"] * (2 * q - 1)
        assert sum(c * m for c, m in terms) == pytest.approx(bend)


def test_an_unknown_effect_is_answered_with_the_nearest():
    with pytest.raises(CaseError, match="did you mean 'skin-layer'"):
        effect("skin_layr")


def test_a_turned_probe_touches_first_where_it_is_nearest():
    """On a cylinder its lowered edge is beside the top: it goes further down, and depth counts from touch."""
    base = on_a_cylinder(radius=50.0)
    body = base.mesh.block("probe").cells.ravel()
    for angle in (2.0, 8.0):
        turned = effect("tilt").apply(
            base, {"tilt_about_short_axis_deg": angle, "tilt_about_long_axis_deg": 0.0}
        )
        x, z = turned.mesh.points[np.unique(body)][:, [0, 2]].T
        above = z - (np.sqrt(50.0**2 - x**2) - 50.0)
        assert above.min() == pytest.approx(0.0, abs=0.05)
        assert turned.info["depth_offset_mm"] == pytest.approx(turned.bodies[0].center_of_mass[2], abs=1e-9)
        assert z.min() < -0.5 * 25.0 * np.sin(np.deg2rad(angle))  # the lowest edge has not touched


@pytest.mark.parametrize(
    ("about", "lowered"), [("short", (25.0, 0.0)), ("long", (0.0, -5.0))], ids=["short", "long"]
)
@pytest.mark.parametrize("angle", [5.0, -3.0])
def test_a_turned_probe_is_the_same_probe_turned_by_so_much(about, lowered, angle):
    """+5 degrees about the short axis lower the side of +x, about the long one that of -y."""
    base = on_a_cylinder(radius=50.0)
    theta = {f"tilt_about_{axis}_axis_deg": angle * (axis == about) for axis in ("short", "long")}
    body = np.unique(base.mesh.block("probe").cells)
    before, after = (model.mesh.points[body] for model in (base, effect("tilt").apply(base, theta)))
    apart = [np.linalg.norm(each[:, None] - each[None], axis=2) for each in (before, after)]
    assert apart[1] == pytest.approx(apart[0], abs=1e-9)
    edge, opposite = (
        np.flatnonzero(np.all(before[:, :2] == np.array(lowered) * s, axis=1))[0] for s in (1, -1)
    )
    way = after[opposite] - after[edge]
    assert np.rad2deg(np.arcsin(way[2] / np.linalg.norm(way))) == pytest.approx(angle)


def test_a_probe_turned_about_the_beam_stays_at_first_touch():
    """Across a cylinder the middle of the face touches its crest, and turned by 90 degrees all of its length:
    at the same height."""
    base = on_a_cylinder(radius=50.0)
    body = np.unique(base.mesh.block("probe").cells)
    along = TURN.apply(base, {"turn_about_beam_deg": 90.0})
    before, after = base.mesh.points[body], along.mesh.points[body]
    assert after[:, :2] == pytest.approx(np.stack([-before[:, 1], before[:, 0]], axis=1), abs=1e-9)
    assert after[:, 2] == pytest.approx(before[:, 2], abs=0.05)
    assert TURN.apply(base, TURN.null) is base


def on_a_cylinder(*, radius: float) -> LimbModel:
    """A flat face 50 x 10 mm on the top of a cylinder along y."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-40, 40, 161), np.linspace(-20, 20, 9)))
    skin = np.stack([x, y, np.sqrt(radius**2 - x**2) - radius], axis=1)
    tri = Delaunay(skin[:, :2]).simplices.astype(np.int64)
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(-25, 25, 51), np.linspace(-5, 5, 3)))
    quads = np.arange(len(u), dtype=np.int64).reshape(3, 51)
    cells = np.stack([quads[:-1, :-1], quads[:-1, 1:], quads[1:, 1:], quads[1:, :-1]], axis=-1).reshape(-1, 4)
    points = np.concatenate([skin, np.stack([u, v, np.zeros(len(u))], axis=1)])
    mesh = Mesh(
        points, (Block("probe", "quad4", cells + len(skin)),), {}, {"skin": Surface("skin", {"tri3": tri})}
    )
    return LimbModel(mesh, {}, (), bodies=(RigidBody("probe", (0.0, 0.0, 0.0), ("probe",)),))
