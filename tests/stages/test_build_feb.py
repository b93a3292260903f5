"""build-feb: the model goes exactly through the measured depths, with settings known to converge."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError, MeasurementError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import apart, schedule
from limbcli.files.atomic import sha256
from limbcli.measurement.indentation import read_levels
from limbcli.model import LimbModel
from limbcli.model.npz_file import load_model
from limbcli.results import sealed
from limbcli.site_model.indentation_model import start_at, starting_depth, touching_points
from limbcli.site_model.site_levels import simulated_depths
from limbcli.stages.build_feb import TissueOptions, build_feb
from tests.stages.block_case import make_case

DEPTHS = np.array([0.8, 1.7, 3.25])
FORCES = np.array([0.3, 0.8, 1.9])


@pytest.fixture
def case(tmp_path: Path) -> Case:
    return make_case(tmp_path / "case", tmp_path / "out", DEPTHS, FORCES, c=0.005, build=False)


def built(case: Case, out: Path, **options: object) -> LimbModel:
    return read_feb(build_feb(case, out=out, **options)[0].path("feb"))  # type: ignore[arg-type]


def edit_levels(case: Case, text: str) -> None:
    header = "force_n,depth_mm,swe_mean_m_per_s,phase\n"
    case.sites[0].levels.write_text(header + text)


def probe_travel(model: LimbModel) -> list[tuple[float, float]]:
    """(time, depth of the probe face) at the points of its load curve."""
    drive = next(each for each in model.drives if each.dof == "z")
    start = model.bodies[0].center_of_mass[2]
    return [(t, -(start + drive.value * y)) for t, y in model.curves[str(drive.curve)].points]


def test_the_load_goes_exactly_through_the_measured_depths(case: Case, tmp_path: Path) -> None:
    model = built(case, tmp_path / "out")
    step = model.steps[0]
    travel = probe_travel(model)
    assert [t for t, _ in travel[1:]] == list(step.must_points)
    assert np.allclose([d for _, d in travel[1:]], DEPTHS, rtol=0, atol=1e-12)
    assert travel[0] == (0, -model.bodies[0].center_of_mass[2])
    assert step.n_steps * step.step_size == step.must_points[-1]
    first = np.interp(step.step_size, *np.array(travel).T)
    assert first - travel[0][1] < 0.5, "the first step is short"


def test_the_probe_starts_a_little_inside_and_touches(case: Case, tmp_path: Path) -> None:
    model = built(case, tmp_path / "out")
    start = -model.mesh.points[model.mesh.block("probe").cells][..., 2].min()
    assert start == pytest.approx(0.05)
    assert model.bodies[0].center_of_mass[2] == pytest.approx(-start)
    assert touching_points(model) >= 12
    edit_levels(case, "0,0,1.6,load\n0.02,0.06,,load\n0.9,2.0,,load\n")
    shallow = built(case, tmp_path / "out")
    assert shallow.bodies[0].center_of_mass[2] == -0.02, "above a level of 0.06 mm"
    assert probe_travel(shallow)[1][1] == pytest.approx(0.06)


@pytest.mark.parametrize(("radius", "start"), [(400, 0.05), (120, 0.1), (60, 0.15), (25, 0.2)])
def test_on_curved_skin_the_probe_starts_deeper(
    case: Case, tmp_path: Path, radius: float, start: float
) -> None:
    model = load_model(tmp_path / "out" / "mesh" / "p1" / "model.npz")
    points = model.mesh.points.copy()
    tissue = np.unique(model.mesh.block("tissue").cells)
    points[tissue, 2] -= (points[tissue, :2] ** 2).sum(axis=1) / 2 / radius
    curved = model.with_mesh(replace(model.mesh, points=points))
    assert starting_depth(curved, 2.0) == start
    assert touching_points(start_at(curved, start)) >= (12 if start < 0.2 else 1)
    assert starting_depth(curved, 0.11) == 0.05, "never beyond half of the first level"


def test_settings_are_those_that_febio_is_known_to_converge_with(
    case: Case, tmp_path: Path, golden: Path
) -> None:
    limb = read_feb(golden / "limb-posterior" / "tet10.feb.gz")
    path = tmp_path / "tet10"
    ours = built(
        make_case(path, path / "out", DEPTHS, FORCES, c=0.005, element="tet10", build=False), path / "out"
    )
    theirs_step, step = limb.steps[0], ours.steps[0]
    same = (
        "step_size",
        "dt_min",
        "dt_max",
        "max_retries",
        "opt_iterations",
        "analysis",
        "adaptive",
    )
    for name in same:
        assert getattr(step, name) == getattr(theirs_step, name), name
    # its first levels were not converged with that
    assert step.control == {**theirs_step.control, "dtol": 0.1 * theirs_step.control["dtol"]}
    theirs = limb.contacts[0]
    assert ours.contacts[0] == replace(
        theirs,
        primary=ours.contacts[0].primary,
        secondary=ours.contacts[0].secondary,
        name=ours.contacts[0].name,
    )
    fixed = {(each.dof, each.kind) for each in limb.drives}
    assert {(each.dof, each.kind) for each in ours.drives} == fixed
    speed_theirs = abs(limb.drives[-1].value)
    times, depths = np.array(probe_travel(ours)).T
    assert (np.diff(depths) / np.diff(times)).max() < 1.1 * speed_theirs, "no faster than the limb's probe"


def test_tet4_gets_tighter_tolerances(case: Case, tmp_path: Path) -> None:
    control = built(case, tmp_path / "out").steps[0].control
    assert (control["dtol"], control["qn_method"], control["symmetric_stiffness"]) == (
        1e-3,
        "BFGS",
        "symmetric",
    )


def test_c_comes_from_shear_waves_at_level_0(case: Case, tmp_path: Path) -> None:
    result = build_feb(case, out=tmp_path / "out")[0]
    law = read_feb(result.path("feb")).materials["tissue"].parameters
    assert law["c1"] == law["c2"] == pytest.approx(0.0025, rel=1e-9)
    assert (law["m1"], law["m2"]) == (2.0, -2.0)
    assert law["kappa"] == pytest.approx(0.5, rel=1e-9)
    assert result.data["c_kpa"] == pytest.approx(5.0, rel=1e-9)
    assert "SWE at level 0" in result.data["c_source"]


def test_values_given_by_hand_win(case: Case, tmp_path: Path) -> None:
    options = TissueOptions(c_kpa=8.0, f_kappa=50.0, m=3.5)
    law = built(case, tmp_path / "out", options=options).materials["tissue"].parameters
    assert (law["c1"], law["m1"], law["m2"]) == (0.004, 3.5, -3.5)
    assert law["kappa"] == pytest.approx(0.4)
    for c_kpa in (-1.0, 8000.0):
        with pytest.raises(MeasurementError, match=r"possible values are 0\.1 to 500"):
            build_feb(case, out=tmp_path / "out", options=TissueOptions(c_kpa=c_kpa))


def test_an_abaqus_file_is_written_on_request(case: Case, tmp_path: Path) -> None:
    (plain,) = build_feb(case, out=tmp_path / "out")
    assert not (plain.folder / "model.inp").exists()
    (found,) = build_feb(case, out=tmp_path / "out", options=TissueOptions(abaqus=True))
    text = found.path("abaqus").read_text()
    assert "*HYPERELASTIC, OGDEN, N=2" in text
    assert "TYPE=C3D" in text


def test_without_swe_c_must_be_given(case: Case, tmp_path: Path) -> None:
    case.sites[0].levels.write_text("force_n,depth_mm\n0,0\n0.3,0.8\n1.9,3.25\n")
    with pytest.raises(MeasurementError, match="--c-kpa"):
        build_feb(case, out=tmp_path / "out")
    assert not (tmp_path / "out" / "build-feb" / "p1").exists()
    assert built(case, tmp_path / "out", options=TissueOptions(c_kpa=5.0)).steps


def test_only_loading_depths_count_sorted_and_once(case: Case, tmp_path: Path) -> None:
    edit_levels(case, "0,0,1.6,load\n0.3,0.8,,load\n0.5,0.8,,load\n1.0,2.0,,load\n0.6,1.5,,unload\n")
    levels = read_levels(case.sites[0].levels)
    assert simulated_depths(levels).tolist() == [0.8, 2.0]
    assert [d for _, d in probe_travel(built(case, tmp_path / "out"))[1:]] == pytest.approx([0.8, 2.0])


def test_a_depth_that_shrinks_is_simulated_in_order_of_depth(case: Case, tmp_path: Path) -> None:
    edit_levels(case, "0,0,1.6,load\n1,2.0,,load\n2,1.4,,load\n3,3.1,,load\n")
    assert simulated_depths(read_levels(case.sites[0].levels)).tolist() == [1.4, 2.0, 3.1]
    result = build_feb(case, out=tmp_path / "out")[0]
    assert any("sorted order" in each for each in result.warnings)


def test_records_ask_for_what_pictures_and_shear_waves_need(case: Case, tmp_path: Path) -> None:
    model = built(case, tmp_path / "out")
    rigid, nodes, elements = model.records
    assert rigid.items == "probe"
    assert {"z", "Fz", "My"} <= set(rigid.fields)
    assert np.array_equal(np.asarray(nodes.items), np.unique(model.mesh.block("tissue").cells))
    assert {"J", "sz", "Fxx", "Fzy"} <= set(elements.fields)
    centroids = model.mesh.points[model.mesh.block("tissue").cells[np.asarray(elements.items)]].mean(axis=1)
    assert np.abs(centroids[:, 0]).max() <= 20
    assert 0 < len(centroids) < len(model.mesh.block("tissue").cells)


def test_the_result_says_what_it_was_made_of(case: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = build_feb(case, out=out)[0]
    used = result.provenance["inputs_sha256"]
    assert used["levels"] == sha256(case.sites[0].levels)
    assert used["mesh"] == sha256(out / "mesh" / "p1" / "model.npz")
    assert result.data["level_depths_mm"] == DEPTHS.tolist()
    mesh = load_model(out / "mesh" / "p1" / "model.npz").mesh
    assert np.array_equal(read_feb(result.path("feb")).mesh.block("tissue").cells, mesh.block("tissue").cells)


def test_the_users_templates_are_used(case: Case, tmp_path: Path) -> None:
    own = tmp_path / "own" / "feb"
    own.mkdir(parents=True)
    (own / "mesh_data.j2").write_text("<!-- from my template -->\n")
    result = build_feb(case, out=tmp_path / "out", templates=tmp_path / "own")[0]
    assert "from my template" in result.path("feb").read_text()
    assert "templates" in result.provenance["inputs_sha256"]


def test_without_a_mesh_it_says_what_to_run(case: Case, tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="limbcli mesh"):
        build_feb(case, out=tmp_path / "elsewhere")


# ---------------------------------------------------------------- the schedule


@pytest.mark.parametrize("seed", range(20))
def test_any_measured_depths_get_exact_short_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depths = np.sort(rng.uniform(0.03, 15, rng.integers(1, 14)))
    kept = apart(depths.tolist())
    plan = schedule(kept)
    assert plan.depths == tuple(kept)
    assert kept[-1] == depths[-1]
    assert all(float(f"{time:.3f}") == time for time in plan.times), "three decimals at most"
    assert plan.n_steps * 0.02 == plan.times[-1], "the last must-point is the end, to the last bit"
    assert (np.diff([0, *plan.times]) > 9e-4).all()
    assert 0.02 <= plan.start < plan.depths[0]


def test_depths_that_do_not_grow_are_refused() -> None:
    for depths in ([], [1.0, 1.0], [2.0, 1.0], [0.01, 1.0]):
        with pytest.raises(CaseError, match="do not increase"):
            schedule(depths)


def test_a_depth_that_the_tissue_does_not_have_is_refused(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "out" / "mesh" / "p1" / "mesh.json"
    found = json.loads(path.read_text())
    for thick, is_refused, told in ((5.5, False, []), (5.0, False, ["65 % of the 5 mm"]), (3.25, True, []),
                                    (None, False, [])):  # fmt: skip
        found["data"] |= {"checks": {"skin_bone_mm": thick}, "measured_skin_bone_mm": None}
        path.write_text(json.dumps(sealed(found)))
        if is_refused:
            with pytest.raises(MeasurementError, match=r"reaches 3.25 mm, .* has 3.25 mm"):
                build_feb(case, out=tmp_path / "out")
        else:
            warnings = build_feb(case, out=tmp_path / "out")[0].warnings
            found_now = [each for each in warnings if "the depth reaches" in each]
            assert len(found_now) == len(told)
            assert all(words in each for words, each in zip(told, found_now, strict=True))


def test_c_without_a_level_0_is_named_for_what_it_is(case: Case, tmp_path: Path) -> None:
    edit_levels(case, "2,1.5,2.0,load\n4,2.4,2.2,load\n6,3.2,2.4,load\n")
    result = build_feb(case, out=tmp_path / "out")[0]
    assert "SWE at level 0" not in result.data["c_source"]
    assert "2 N and 1.5 mm" in result.data["c_source"]
    (reason,) = [each for each in result.warnings if "no level 0" in each]
    assert "6.48 kPa at 0 N" in reason, "2 rho (1.8 m/s)^2"
    given = build_feb(case, out=tmp_path / "out", options=TissueOptions(c_kpa=6.48))[0]
    assert not [each for each in given.warnings if "no level 0" in each]
