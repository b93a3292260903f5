"""fit on tissue that was loaded several times: which loading is fitted, and what the others say to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import limbcli
from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.fitting.fitted_cycle import write_cycle
from limbcli.measurement.elastography import SweMap, write_map
from limbcli.provenance.requested_options import in_words
from limbcli.site_model.site_levels import levels_of, maps_of
from limbcli.stages.build_feb import build_feb
from limbcli.stages.check import check
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.report import report
from limbcli.stages.report_pages.material import gather
from tests.stages import block_case as block

pytestmark = pytest.mark.slow

TRUTH = {"c": 0.008, "f_kappa": 150.0, "m": 3.0}
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])
LEFT, STIFFER = 0.7, 1.6  # mm that stays after cycle 1; how much stiffer the first loading is
QUICK = FitOptions(intervals=False, contact_check=False, boundary_check=False)


@pytest.fixture(scope="module")
def forces() -> np.ndarray:
    return block.true_curve("tet4", DEPTHS, **TRUTH)


def write_cycles(folder: Path, forces: np.ndarray) -> None:
    """Three cycles: the first stiffer, the others the tissue's own curve from 0.7 mm on."""
    speed = np.sqrt(TRUTH["c"] * 1e6 / 2 / 1000.0)
    rows = ["cycle,phase,force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels"]
    for cycle, (gain, left) in enumerate(((STIFFER, 0.0), (1.0, LEFT), (1.0, LEFT)), 1):
        rows.append(f"{cycle},load,0,{left:.12g},{np.sqrt(gain) * speed:.12g},0.1,100")
        pairs = list(zip(DEPTHS, forces, strict=True))
        rows += [f"{cycle},load,{gain * f:.12g},{d + left:.12g},,," for d, f in pairs]
        rows += [f"{cycle},unload,{0.5 * gain * f:.12g},{d + left:.12g},,," for d, f in pairs[-2::-1]]
    (folder / "levels.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def built(forces, tmp_path_factory) -> tuple[Case, Path]:
    root = tmp_path_factory.mktemp("cycles")
    block.make_case(root / "case", root / "out", DEPTHS, forces, c=TRUTH["c"], build=False)
    write_cycles(root / "case", forces)
    case = Case.open(root / "case")
    build_feb(case, out=root / "out")
    return case, root / "out"


def test_the_last_loading_is_fitted_from_its_own_first_touch(built):
    case, out = built
    found = fit(case, out=out, solver="reference", options=QUICK)[0]
    assert found.data["f_kappa"] == pytest.approx(150.0, rel=0.02)
    assert found.data["m"] == pytest.approx(3.0, rel=0.02)
    reported = found.data["cycle"]
    assert (reported["fitted"], reported["of"], reported["repeats_from"]) == (3, 3, 2)
    assert reported["zero_depth_mm"] == pytest.approx(LEFT)
    assert reported["contradicted_by"] is None
    assert reported["energy_lost_fraction"] > 0.2
    assert not any("contradicts" in each for each in found.warnings)


def test_a_fit_on_a_first_cycle_that_later_ones_contradict_says_so(built):
    case, out = built
    found = fit(case, out=out, solver="reference", options=FitOptions(
        cycle="1", intervals=False, contact_check=False, boundary_check=False))[0]  # fmt: skip
    assert found.data["c_kpa"] == pytest.approx(1e3 * TRUTH["c"] * STIFFER)
    assert found.data["cycle"]["fitted"] == 1
    assert found.data["cycle"]["contradicted_by"] == 3
    assert any("cycle 3 contradicts the fitted cycle 1" in each for each in found.warnings)
    assert found.data["asked"]["cycle"] == "1", "a batch fits it again in the same way"
    assert "--cycle 1" in in_words(found.data["asked"])
    site = gather(case, out=out).sites[0]
    assert "contradicts the fitted cycle 1" in site.cycles.contradiction
    np.testing.assert_allclose(site.measured.depth[:5], np.r_[0.0, DEPTHS])
    page = report(case, out=out)
    text = page.path("page").read_text(encoding="utf-8")
    assert "Is the response repeatable" in text
    assert "The parameters on this page are of cycle 1." in text
    assert (page.folder / "figures" / "cycles-p1.png").is_file()


def test_a_cycle_whose_depths_were_not_built_is_simulated_at_its_own(built, forces):
    """Cycle 1 reaches other depths than the last: the model is driven through them."""
    case, out = built
    folder = case.folder
    before = (folder / "levels.csv").read_text()
    try:
        rows = ["cycle,force_n,depth_mm,swe_mean_m_per_s"]
        rows += [f"1,{f:.12g},{d:.12g},{2 if d == 0 else ''}"
                 for d, f in zip(np.r_[0, DEPTHS], np.r_[0, forces], strict=True)]  # fmt: skip
        rows += [f"2,{f:.12g},{d:.12g},{2 if d == 0 else ''}"
                 for d, f in zip(np.r_[0, DEPTHS[:3]], np.r_[0, forces[:3]], strict=True)]  # fmt: skip
        (folder / "levels.csv").write_text("\n".join(rows) + "\n")
        build_feb(case, out=out)
        options = FitOptions(cycle="1", intervals=False, contact_check=False, boundary_check=False)
        found = fit(case, out=out, solver="reference", options=options)[0]
        assert found.data["n_levels"] == 5
        assert found.data["f_kappa"] == pytest.approx(150.0, rel=0.02)
        assert found.data["rmse_n"] < 0.01
    finally:
        (folder / "levels.csv").write_text(before)
        build_feb(case, out=out)


@pytest.mark.parametrize(
    ("cycle", "text"), [("4", "there is no cycle 4"), ("zero", "--cycle is 'zero'"), ("0", "--cycle is '0'")]
)
def test_a_cycle_that_is_not_there_is_refused(built, cycle, text):
    case, out = built
    with pytest.raises(CaseError, match=text):
        fit(case, out=out, solver="reference", options=FitOptions(cycle=cycle))
    with pytest.raises(CaseError, match=text):
        limbcli.fit(case, out=out, cycle=cycle)


def test_maps_are_those_of_the_cycles_rows(built):
    case, _ = built
    site = case.sites[0]
    folder = case.folder / "swe"
    folder.mkdir()
    for k in range(24):
        write_map(folder / f"level_{k:02d}.csv", SweMap(np.zeros(1), np.ones(1), np.array([1.0 + 0.1 * k])))
    mapped = replace(site, swe_maps=folder)
    found = maps_of(mapped, levels_of(mapped, "2"))
    np.testing.assert_allclose([float(each.speed_m_per_s[0]) for each in found], 1.0 + 0.1 * np.arange(8, 16))


def test_one_whole_loading_is_not_said_to_differ_from_one_before(built, tmp_path):
    """A touch of 2 N before it is no curve that it could repeat."""
    rows = ["cycle,force_n,depth_mm", "1,0,0", "1,2,1"]
    rows += [f"2,{2 * k},{k}" for k in range(4)]
    (tmp_path / "levels.csv").write_text("\n".join(rows) + "\n")
    site = replace(built[0].sites[0], levels=tmp_path / "levels.csv")
    writer = SimpleNamespace(data={}, summary=[], warnings=[])
    write_cycle(levels_of(site), site, writer)
    assert (writer.data["cycle"]["fitted"], writer.data["cycle"]["repeats_from"]) == (2, None)
    assert writer.warnings == []


def test_check_tells_the_cycles(built):
    case, _ = built
    assert any("3 cycles (5, 5, 5 levels of loading)" in each for each in check(case.folder).shown)


def test_levels_that_change_make_the_fit_stale_and_its_command_keeps_the_cycle(built):
    case, out = built
    fit(case, out=out, solver="reference", options=replace(QUICK, cycle="2"))
    assert not gather(case, out=out).notices
    path = case.folder / "levels.csv"
    before = path.read_text()
    try:
        path.write_text(before.replace("3,load,0,0.7", "3,load,0,0.71"))
        with pytest.raises(CaseError, match="changed"):
            fit(case, out=out, solver="reference", options=QUICK)
        assert any("--cycle 2" in each for each in gather(case, out=out).notices)
    finally:
        path.write_text(before)
