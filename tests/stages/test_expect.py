"""expected.toml: a result outside its tolerance is found, a slip in the file too."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.stages.batch_cases import expectations
from limbcli.stages.expect import compare
from tests.case.test_case_text import two_sites


@pytest.fixture
def out(tmp_path: Path) -> Path:
    with open_stage(tmp_path / "out", "fit", subject="S1", site="p1") as writer:
        writer.data.update({"m": 2.1, "element": "tet10", "flags": {"m": "identified"}, "r2": None})
    return tmp_path / "out"


@pytest.mark.parametrize(
    ("rule", "holds"),
    [
        ("m = { value = 2.0, tolerance = 0.2 }", True),
        ("m = { value = 2.0, tolerance = 0.05 }", False),
        ("m = { value = 2.0, relative = 0.06 }", True),
        ("m = { min = 2.2 }", False),
        ("m = { max = 2.2 }", True),
        ('element = { is = "tet4" }', False),
        ('"flags.m" = { is = "identified" }', True),
        ("r2 = { min = 0.9 }", False),
        ("absent = { min = 0.9 }", False),
    ],
)
def test_rule_holds_or_not(tmp_path: Path, out: Path, rule: str, holds: bool):
    (tmp_path / "expected.toml").write_text(f"[site.p1]\n{rule}\n")
    assert [each.holds for each in compare(tmp_path, out)] == [holds]


def test_elements_side_by_side_can_be_expected(tmp_path: Path, out: Path):
    with open_stage(out, "fit-elements", subject="S1", site="p1") as writer:
        writer.data["elements"] = {"tet10": {"f_kappa": 900.0}}
    (tmp_path / "expected.toml").write_text('[elements.p1]\n"elements.tet10.f_kappa" = { min = 500.0 }\n')
    assert [each.holds for each in compare(tmp_path, out)] == [True]


def test_missing_result_is_a_failure(tmp_path: Path, out: Path):
    (tmp_path / "expected.toml").write_text("[site.p2]\nm = { min = 0 }\n")
    assert [each.holds for each in compare(tmp_path, out)] == [False]


@pytest.mark.parametrize("rule", ["m = { valu = 2.0 }", "m = 2.0", "m = {}"])
def test_misspelt_rule_is_refused(tmp_path: Path, out: Path, rule: str):
    (tmp_path / "expected.toml").write_text(f"[site.p1]\n{rule}\n")
    with pytest.raises(CaseError, match="not valid"):
        compare(tmp_path, out)


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("[sites.p1]\nm = { value = 2.0 }", "no expectations of 'sites'"),
        ('site = "p1"', "site is not a table"),
        ("[site]\np1 = 3", "site.p1 is not a table"),
        ("fit-joint = 3", "fit-joint is not a table"),
        ('[site.p1]\nm = { value = "2" }', "no number as its value"),
        ("[site.p1]\nm = { min = nan }", "no number as its min"),
        ("[site.p1]\nm = { value = 2.0, tolerance = [1] }", "no number as its tolerance"),
        ("[site.p1]\nm = { tolerance = 0.1 }", "a tolerance but no value"),
        ("[site.p1]\nm = { value = 2.0, tolerance = -0.1 }", "a tolerance below 0"),
        ("[site.p1]\nm = { is = 2.1, max = 1.0 }", "`is` together with other keys"),
        ("[site.p2]\nm = { tolerance = 0.1 }", "a tolerance but no value"),
    ],
)
def test_what_could_not_fail_or_is_no_rule_is_refused_and_stops_no_batch(
    tmp_path: Path, out: Path, text: str, given: str
):
    (tmp_path / "expected.toml").write_text(text)
    found, unlike = expectations(tmp_path, out, progress=SILENT)
    assert not found
    assert given in unlike[0].error.what
    assert unlike[0].error.fix


def test_case_without_expectations_says_how_to_write_them(tmp_path: Path, out: Path):
    with pytest.raises(CaseError, match=r"no expected\.toml"):
        compare(tmp_path, out)


def test_fibres_of_a_mesh_and_a_joint_fit_can_be_expected(tmp_path: Path):
    with open_stage(tmp_path / "out", "mesh", subject="S1", site="p1") as writer:
        writer.data["fibres"] = {"out_of_skin_deg": 12.4}
    with open_stage(tmp_path / "out", "fit-joint", subject="S1") as writer:
        writer.data["fibre_shear"] = 1.3
    (tmp_path / "expected.toml").write_text(
        '[mesh.p1]\n"fibres.out_of_skin_deg" = { value = 12.0, tolerance = 1.0 }\n'
        "[fit-joint]\nfibre_shear = { max = 1.2 }\n"
    )
    assert [each.holds for each in compare(tmp_path, tmp_path / "out")] == [True, False]


def test_a_result_counts_only_for_the_case_that_it_was_made_of(tmp_path: Path):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    levels = Case.open(case).site("p1").levels
    for site in ("p1", "p2", "p9"):
        with open_stage(out, "fit", subject="S1", site=site) as writer:
            writer.data.update({"m": 2.1, "poor": True})
            writer.used("levels", levels, role="site/p1/levels")
    (case / "expected.toml").write_text(
        "".join(f"[site.{site}]\nm = {{ min = 2.0 }}\n" for site in ("p1", "p2", "p9"))
    )
    found, unlike = expectations(case, out, progress=SILENT)
    assert [each.holds for each in found] == [True, True, False]
    assert "the case has no site p9" in unlike[0].error.what
    levels.write_text(levels.read_text() + "\n")
    found, _ = expectations(case, out, progress=SILENT)
    assert [each.holds for each in found] == [False, False, False]
    assert "levels of site p1 changed" in str(found[0].found)


def test_true_is_no_number(tmp_path: Path, out: Path):
    with open_stage(out, "fit", subject="S1", site="p1") as writer:
        writer.data.update({"poor": True, "n": 1})
    (tmp_path / "expected.toml").write_text("[site.p1]\npoor = { is = 1 }\nn = { is = 1.0 }\n")
    assert [each.holds for each in compare(tmp_path, out)] == [False, True]
