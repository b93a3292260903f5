"""The states' levels, and what of their stretches is known and searched for."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError, MeasurementError
from limbcli.fitting.state_plan import plan_of
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.progress import SILENT
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.staleness import Chain
from limbcli.results import open_stage, read_result
from limbcli.site_model.site_states import states_of
from limbcli.stages.batching.outcome import BatchOptions
from limbcli.stages.batching.steps import site_steps
from limbcli.stages.check import check
from limbcli.stages.simulated_subjects.synth_case import case_table
from tests.stages import state_case

READ = {name: (np.array([0.0, 2.0, 4.0]), np.array([0.0, 1.0, 1.8]), np.array([1.6, 1.8, 2.1]))
        for name in state_case.TOLD}  # fmt: skip
NAMES = ["middle", "bent", "straight"]


def written(folder: Path) -> Path:
    folder.mkdir()
    (folder / "case.toml").write_text(state_case.case_text(state_case.TOLD))
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid empty\nendsolid empty\n")
    for name, columns in READ.items():
        rows = [
            "force_n,depth_mm,swe_mean_m_per_s",
            *(f"{f},{d},{v}" for f, d, v in zip(*columns, strict=True)),
        ]
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_every_state_has_its_own_levels(tmp_path: Path):
    found = states_of(Case.open(written(tmp_path / "case")).sites[0])
    assert [each.state.name for each in found] == NAMES
    assert all(len(each.levels) == 3 for each in found)


@pytest.mark.parametrize(
    ("first", "message"),
    [("0,0,", "has no shear-wave speed at rest"), ("1.5,0.4,1.7", "has no level at rest (0 N)")],
)
def test_a_state_without_rest_is_an_error_for_fit_and_check(tmp_path: Path, first: str, message: str):
    folder = written(tmp_path / "case")
    path = folder / "bent.csv"
    path.write_text(path.read_text().replace("0.0,0.0,1.6", first))
    with pytest.raises(MeasurementError) as raised:
        states_of(Case.open(folder).sites[0])
    assert raised.value.what == f"state bent of site p1 {message}"
    assert "make its first row the reading at first touch" in raised.value.fix
    reported = check(folder)
    assert [each.what for each in reported.problems if "state bent" in each.what] == [raised.value.what]
    assert "bent.csv" in reported.looked_at
    assert reported.exit_code


def test_a_broken_file_is_reported_once_by_check(tmp_path: Path):
    folder = written(tmp_path / "case")
    (folder / "bent.csv").write_text("force_n\n0\n")
    about = [each for each in check(folder).problems if "bent.csv" in each.where]
    assert len(about) == len({each.what for each in about}) >= 1
    with pytest.raises(MeasurementError):
        states_of(Case.open(folder).sites[0])


def test_told_stretches_share_one_unloaded_stretch_that_is_searched():
    plan = plan_of({"along": [0.9, 0.72, 1.1], "around": [1.0, 1.0, 1.0]}, {}, NAMES)
    assert plan.ways == ("along",)
    assert [each.name for each in plan.parameters] == ["unloaded_stretch_along"]
    np.testing.assert_allclose(plan.stretches(1, np.array([0.96])), [0.75])
    assert plan.elastic(1, "around", np.array([0.96])) == 1.0
    assert (plan.taken, plan.unloaded) == (("around",), {"around": 1.0})
    assert plan.is_known(0, "around")
    assert not plan.is_known(0, "along")


def test_unknown_stretches_are_searched_one_by_one():
    plan = plan_of({"along": [1.0, None, None]}, {"along": 1.0}, NAMES)
    assert [each.name for each in plan.parameters] == ["stretch_along_bent", "stretch_along_straight"]
    values = np.array([0.8, 1.2])
    assert [plan.elastic(k, "along", values) for k in range(3)] == pytest.approx([1.0, 0.8, 1.2])
    assert [plan.is_known(k, "along") for k in range(3)] == [True, False, False]


def test_the_only_stretch_that_is_given_is_not_taken_for_that_of_unloaded_tissue():
    """The state of reference has a stretch of 1 by definition, unloaded or not."""
    plan = plan_of({"along": [1.0, None, None]}, {}, NAMES)
    assert [each.name for each in plan.parameters] == [
        "unloaded_stretch_along", "stretch_along_bent", "stretch_along_straight",
    ]  # fmt: skip
    assert plan.taken == ()
    assert plan.elastic(0, "along", np.array([0.95, 0.8, 1.2])) == pytest.approx(1.0 / 0.95)


def test_a_known_unloaded_stretch_leaves_nothing_to_search():
    plan = plan_of({"along": [0.9, 0.72, 1.1]}, {"along": 0.9}, NAMES)
    assert plan.parameters == ()
    np.testing.assert_allclose(np.exp(plan.offsets[:, 0]), [1.0, 0.8, 1.1 / 0.9])


def test_told_and_unknown_stretches_and_both_ways_go_together():
    plan = plan_of({"along": [0.9, 1.1, None], "around": [None, 1.0, 1.05]}, {"around": 1.0}, NAMES)
    assert [each.name for each in plan.parameters] == [
        "unloaded_stretch_along", "stretch_along_straight", "stretch_around_middle",
    ]  # fmt: skip
    found = np.array([plan.stretches(k, np.array([0.95, 1.2, 1.02])) for k in range(3)])
    np.testing.assert_allclose(found, [[0.9 / 0.95, 1.02], [1.1 / 0.95, 1.0], [1.2, 1.05]])


@pytest.mark.parametrize(
    ("given", "known", "message"),
    [
        ({"along": [1.0, 1.0], "around": [1.0, 1.0]}, {}, "do not differ in their stretch"),
        ({"along": [0.9, 1.9]}, {"along": 1.0}, "a state's stretch along the limb is 1.9"),
        ({"along": [0.5, 2.0]}, {}, "possible values are 0.6 to 1.6"),
    ],
)
def test_states_that_tell_nothing_or_too_much_are_errors(given, known, message):
    with pytest.raises(CaseError, match=message):
        plan_of(given, known, NAMES[:2], where="site p1")


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [("1.0", "1.0", "do not differ in their stretch"), ("0.5", "2.0", "possible values are 0.6 to 1.6")],
)
def test_check_tells_what_a_fit_of_the_states_would_refuse(tmp_path: Path, first, second, message):
    folder, stretches = written(tmp_path / "case"), itertools.chain([first], itertools.repeat(second))
    text = (folder / "case.toml").read_text()
    text = re.sub(r"(stretch_around) = \S+", lambda found: f"{found[1]} = {next(stretches)}", text)
    (folder / "case.toml").write_text(text)
    assert [each.severity for each in check(folder).problems if message in each.what] == ["error"]


def test_a_batch_fits_the_states_after_the_force(tmp_path: Path):
    case = Case.open(written(tmp_path / "case"))
    requested = {stage: {} for stage in ("mesh", "build-feb", "run", "fit", "fit-states")}
    steps = site_steps(case, "p1", BatchOptions(), requested, out=tmp_path / "out", progress=SILENT)
    assert [each.stage for each in steps] == ["mesh", "build-feb", "run", "fit", "fit-states"]


def test_every_state_s_file_is_recorded_where_the_states_are_read(tmp_path: Path):
    case, out = Case.open(written(tmp_path / "case")), tmp_path / "out"
    with open_stage(out, "fit-states", subject=case.subject, site="p1") as writer:
        states_of(noted(case, writer).site("p1"))
    result = read_result(out, "fit-states", site="p1")
    roles = {f"site/p1/state/{each.name}" for each in case.sites[0].states}
    assert set(result.provenance["made_from"]["files"]) == roles
    assert Chain(case, out).broken(result) is None
    path = case.sites[0].states[1].levels
    path.write_text(path.read_text() + "\n")
    broken = Chain(case, out).broken(result)
    assert broken is not None
    assert path.name in broken.where


def test_a_simulated_case_of_a_site_with_states_has_the_levels_of_each(tmp_path: Path):
    case = Case.open(written(tmp_path / "case"))
    table = case_table(case, {"p1": NoiseLaw(0.1, 0.3, 0.05, 0.1)})["site"][0]
    assert {"levels", "trace", "swe_maps"}.isdisjoint(table)
    before = case.raw["site"][0]["state"]
    assert [{**each, "levels": ""} for each in table["state"]] == [{**each, "levels": ""} for each in before]
    assert [each["levels"] for each in table["state"]] == [f"p1/{each['name']}/levels.csv" for each in before]
