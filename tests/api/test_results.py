"""Every function on a small case: what it returns, what it says to listeners, what the command says too."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import limbcli
from limbcli.cli.app import main
from tests.benchmarks.small_case import write_case
from tests.stages import block_case

pytestmark = pytest.mark.slow

CASES = Path(__file__).resolve().parents[2] / "cases"
SIZES = {"size_mm": 6.0, "far_size_mm": 12.0}


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The stages up to the report, called as a notebook calls them; and what was heard of each."""
    folder = tmp_path_factory.mktemp("python")
    out = folder / "out"
    case = limbcli.Case.open(str(write_case(folder / "case")))
    heard: list[str] = []
    found: dict[str, Any] = {"case": case, "out": out, "heard": heard}
    found["segment"] = limbcli.segment(case, out=out)
    found["mesh"] = limbcli.mesh(case, out=out, **SIZES, progress=lambda kind, facts: heard.append(kind))
    found["build"] = limbcli.build_feb(case.folder, out=str(out), c_kpa=8.0)
    found["run"] = limbcli.run(case, out=out, solver="reference")
    found["fit"] = limbcli.fit(
        case,
        out=out,
        sites="p1",
        solver="reference",
        c_kpa=8.0,
        intervals=False,
        contact_check=False,
        boundary_check=False,
    )
    found["report"] = limbcli.report(case, out=out)
    return found


def test_numbers_are_attributes_with_units(chain: dict[str, Any]):
    mesh, built, run, fit = (chain[name]["p1"] for name in ("mesh", "build", "run", "fit"))
    assert chain["segment"].bones == ("tibia",)
    assert chain["segment"].volume_cm3["skin"] > 100
    assert 3.0 < mesh.edge_under_probe_mm < 9.0
    assert mesh.model().mesh.points.shape == (mesh.n_nodes, 3) or mesh.n_nodes > 0
    assert built.c_kpa == pytest.approx(8.0)
    assert built.kappa_kpa == pytest.approx(800.0)
    assert built.model().materials["tissue"].law == "ogden"
    assert run.solver == "reference"
    assert run.curve()["force_n"].max() == pytest.approx(run.max_force_n)
    assert fit.kappa_kpa == pytest.approx(fit.c_kpa * fit.f_kappa)
    assert fit.parameter("f_kappa").value == fit.f_kappa
    assert np.isfinite(fit.curves()["measured_n"]).sum() >= 3
    assert chain["report"].page.is_file()
    with pytest.raises(FrozenInstanceError):
        fit.m = 3.0
    with pytest.raises(KeyError, match="the parameters are c_kpa, f_kappa, m"):
        fit.parameter("kappa")


def test_every_result_is_a_table_and_a_pandas_frame(chain: dict[str, Any]):
    pandas = pytest.importorskip("pandas")
    for name in ("segment", "mesh", "build", "run", "fit", "report"):
        found = chain[name]
        frame = found.to_frame()
        assert isinstance(frame, pandas.DataFrame)
        assert list(frame.columns) == list(found.table().dtype.names or ())
        assert len(frame) == len(found.table()) == len(found.rows())
    rows = chain["fit"].to_frame().set_index("parameter")
    assert list(rows.index) == ["c_kpa", "f_kappa", "m"]
    assert rows.loc["m", "value"] == chain["fit"][0].m
    assert np.isnan(rows.loc["m", "low_95"])  # no interval was requested
    assert (rows["subject"] == "S1").all()
    assert "stage" not in chain["mesh"].to_frame().columns


def test_without_pandas_it_says_what_to_do(chain: dict[str, Any], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(limbcli.ToolError, match="pip install pandas"):
        chain["fit"].to_frame()
    assert chain["fit"].table()["parameter"].tolist() == ["c_kpa", "f_kappa", "m"]


def test_a_result_is_read_back_as_it_was(chain: dict[str, Any]):
    again = limbcli.FitResult.read(chain["out"], site="p1")
    assert again.rows() == chain["fit"].rows()
    assert again.to_json() == chain["fit"]["p1"].to_json()
    with pytest.raises(limbcli.CaseError, match="there is no result of `diagnose`"):
        limbcli.DiagnosisResult.read(chain["out"], site="p1")


def test_the_command_says_the_same(chain: dict[str, Any], capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """One code path: the command and the function leave the same numbers."""
    case = str(chain["case"].folder)
    main_ = ["segment", case, "--out", str(tmp_path), "--json", "--quiet"]
    assert _shown(main_, capsys)["data"] == chain["segment"].data
    sizes = [text for name, value in SIZES.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    (shown,) = _shown(["mesh", case, "--out", str(tmp_path), *sizes, "--json", "--quiet"], capsys)
    assert shown["data"] == chain["mesh"]["p1"].data


def _shown(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> Any:
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert not stop.value.code
    return json.loads(capsys.readouterr().out)


def test_progress_is_silent_unless_it_is_heard(
    chain: dict[str, Any], capfd: pytest.CaptureFixture[str], tmp_path: Path
):
    assert {"stage", "note"} <= set(chain["heard"])
    limbcli.segment(chain["case"], out=tmp_path)
    shown = capfd.readouterr()
    assert (shown.out, shown.err) == ("", "")


def test_sites_by_number_by_name_and_together(chain: dict[str, Any]):
    several = chain["mesh"]
    assert several[0] is several["p1"] is several[np.int64(0)]
    assert "p1" in several
    assert "p9" not in several
    assert several[0] in several
    assert len(several) == len(list(several)) == 1
    assert several[:1].results == several.results
    with pytest.raises(limbcli.CaseError, match="the sites are: p1"):
        several["p9"]
    assert str(several["p1"]).startswith("mesh p1: ")


def test_errors_say_what_where_and_what_to_do(chain: dict[str, Any], tmp_path: Path):
    case, out = chain["case"], tmp_path / "out"
    wrong: list[tuple[Any, str]] = [
        (lambda: limbcli.Case.open(tmp_path / "nowhere"), "there is no case folder"),
        (lambda: limbcli.segment(tmp_path / "nowhere"), "there is no case folder"),
        (lambda: limbcli.segment(7), "case is 7, not a path"),  # type: ignore[arg-type]
        (lambda: limbcli.segment(case, out=out, smooth_mm=9.0), "smooth_mm is 9, outside of 0 to 5"),
        (lambda: limbcli.segment(case, out=out, limb="middle"), "limb is 'middle'"),  # type: ignore[arg-type]
        (lambda: limbcli.segment(case, out=out, progress="loud"), "cannot be called"),  # type: ignore[arg-type]
        (lambda: limbcli.mesh(case, out=out), "there is no result of `segment`"),
        (lambda: limbcli.mesh(case, out=out, size_mm=float("nan")), "size_mm is nan, not a finite number"),
        (lambda: limbcli.mesh(case, out=out, size_mm="4"), "size_mm is '4', not a finite"),  # type: ignore
        (lambda: limbcli.mesh(case, out=out, element="hex8"), "element is 'hex8'"),  # type: ignore[arg-type]
        (lambda: limbcli.mesh(case, out=out, at=(1.0,)), "at is"),  # type: ignore[arg-type]
        (lambda: limbcli.mesh(case, out=out, fat_mm="thick"), "fat_mm is 'thick'"),  # type: ignore[arg-type]
        (lambda: limbcli.mesh(case, out=chain["out"], sites="p9"), "there is no site 'p9'"),
        (lambda: limbcli.build_feb(case, out=out, m=0.5), "m is 0.5, outside of 1 to 100"),
        (lambda: limbcli.build_feb(case, out=out, layers={"fat": {"c_kpa": "soft"}}), "not a number"),
        (lambda: limbcli.run(case, out=out, solver="abaqus"), "solver is 'abaqus'"),  # type: ignore[arg-type]
        (lambda: limbcli.fit(case, out=out, max_iterations=1.5), "not a whole number"),  # type: ignore
        (lambda: limbcli.fit(case, out=out, c_kpa=float("inf")), "not a finite number"),
        (lambda: limbcli.fit(case, out=out, gain_deviation_fraction=5.0), "possible values are 0 to 2"),
        (lambda: limbcli.fit_joint(case, out=out, law="hooke"), "hooke"),
        (lambda: limbcli.diagnose(case, out=out, effects="frction"), "there is no effect 'frction'"),
        (lambda: limbcli.diagnose(case, out=out, measured={"tare_n": True}), "tare_n is True"),
        (lambda: limbcli.synth(case, tmp_path / "new", out=out, noise=-1.0), "noise is -1"),
        (lambda: limbcli.make_phantom(chain["case"].folder), "is there already"),
        (lambda: limbcli.read_feb(tmp_path / "none.feb"), "none.feb"),
    ]
    for call, words in wrong:
        with pytest.raises(limbcli.LimbcliError) as caught:
            call()
        assert words in f"{caught.value}", words
        assert caught.value.message
        assert caught.value.where
        assert caught.value.fix
    assert not out.exists()


def test_arguments_of_another_kind_are_refused(chain: dict[str, Any], tmp_path: Path):
    case, out = chain["case"], tmp_path / "out"
    wrong: list[tuple[Any, str]] = [
        (lambda: limbcli.segment(case, out=out, seeds=[("bone", (1, 2))]), "seeds is"),  # type: ignore
        (lambda: limbcli.segment(case, out=out, seeds=("bone", (1, 2, 3))), "seeds is"),  # type: ignore
        (lambda: limbcli.segment(case, out=out, seeds="bone=1,2,3"), "seeds is"),  # type: ignore[arg-type]
        (lambda: limbcli.build_feb(case, out=out, layers={"fat": 3}), "layers is"),  # type: ignore[dict-item]
        (lambda: limbcli.build_feb(case, out=out, sites=3), "sites is 3"),  # type: ignore[arg-type]
        (lambda: limbcli.FitResult.read(case, "p1"), "out is Case("),  # type: ignore[arg-type]
    ]
    for call, words in wrong:
        with pytest.raises(limbcli.CaseError) as caught:
            call()
        assert words in caught.value.message
        assert len(caught.value.message) < 200


def test_results_hold_from_another_working_folder(
    chain: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copytree(chain["out"], tmp_path / "out" / "case")
    shutil.copytree(chain["case"].folder, tmp_path / "case")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    case = limbcli.Case.open("case")
    built = limbcli.build_feb("case", c_kpa=8.0)["p1"]
    fitted = limbcli.FitResult.read("out/case", "p1")
    monkeypatch.chdir("elsewhere")
    assert built.feb.is_file()
    assert built.model().bodies
    assert len(fitted.curves()) == len(chain["fit"]["p1"].curves())
    with pytest.raises(limbcli.CaseError, match="was not found from"):
        limbcli.build_feb(case)


def test_the_site_that_was_forgotten_or_misspelt_is_named(chain: dict[str, Any]):
    for site in (None, "P1"):
        with pytest.raises(limbcli.CaseError) as caught:
            limbcli.FitResult.read(chain["out"], site)
        assert caught.value.fix == "name one of its sites: p1"
    with pytest.raises(limbcli.CaseError, match="the whole subject's"):
        limbcli.SegmentResult.read(chain["out"], "p1")


def test_segment_begins_before_sites_and_probe_are_known(tmp_path: Path):
    case = write_case(tmp_path / "case")
    path = case / "case.toml"
    path.write_text(re.sub(r"(length_mm|position_mm|long_axis) = .*", r'\1 = "FILL IN"', path.read_text()))
    assert limbcli.segment(case, out=tmp_path / "out").bones == ("tibia",)
    with pytest.raises(limbcli.CaseError, match="still to be filled in"):
        limbcli.mesh(case, out=tmp_path / "out")


def test_a_second_writer_is_refused_where_nobody_waits(chain: dict[str, Any], tmp_path: Path):
    from limbcli.files.output_lock import one_writer

    with one_writer(tmp_path), pytest.raises(limbcli.CaseError, match="is writing into this output folder"):
        limbcli.segment(chain["case"], out=tmp_path, wait=False)


def test_check_returns_problems_and_raises_none(chain: dict[str, Any], tmp_path: Path):
    good = limbcli.check(chain["case"].folder)
    assert good.ok
    assert limbcli.check(chain["case"]).looked_at == good.looked_at
    (tmp_path / "case.toml").write_text("format = 1\n")
    bad = limbcli.check(tmp_path)
    assert not bad.ok
    assert set(bad.table()["severity"]) == {"error"}
    assert len(bad.table()) == len(bad.problems) > 2


def test_fits_of_several_sites_and_of_both_elements(tmp_path: Path):
    """On a block of tissue, stiffer and stiffer as it is pressed."""
    out = tmp_path / "out"
    depths, forces = np.array([0.9, 1.8, 2.7]), np.array([0.9, 2.4, 4.8])
    small = block_case.block_model(counts=(5, 4, 2))
    case = block_case.make_case(tmp_path / "case", out, depths, forces, c=0.008, model=small)
    joint = limbcli.fit_joint(case, out=out, law="neo-hooke", contact_check=False, boundary_check=False)
    assert joint.sites == ("p1",)
    assert joint.law == "neo-hooke"
    assert joint.parameter("c_kpa").value > 0
    assert joint.table()["parameter"].tolist()[0] == "c_kpa"
    assert limbcli.JointFitResult.read(out).rows() == joint.rows()
    both = limbcli.compare_elements(case, out=out, max_iterations=8, tolerance=0.05)["p1"]
    assert both.table()["element"].tolist() == ["tet4", "tet10"]
    assert both.force_ratio_tet4_over_tet10 > 1.0  # linear elements are never softer


def test_the_instruments_files_become_a_table_of_levels(tmp_path: Path):
    """`measure` on the load-cell record of the synthetic case that is kept."""
    (found,) = limbcli.measure(CASES / "phantom", out=tmp_path)
    levels = found.table()
    known = np.genfromtxt(CASES / "phantom" / "p1" / "levels.csv", delimiter=",", names=True)
    assert np.allclose(levels["force_n"], known["force_n"], atol=0.5)
    assert set(levels["site"]) == {"p1"}


def test_a_session_solves_the_model_again_with_other_parameters(chain: dict[str, Any]):
    model = limbcli.read_feb(chain["build"]["p1"].feb)
    with limbcli.ReferenceSession(model, threads=1) as session:
        first = session.solve()
        tissue = model.materials["tissue"]
        half = {name: 0.5 * tissue.parameters[name] for name in ("c1", "c2", "kappa")}
        softer = tissue.with_parameters(**half)
        second = session.solve(model.with_material("tissue", softer))
    levels = chain["run"]["p1"].table()
    assert np.isclose(first.must_points.forces, levels["force_n"][-1], rtol=1e-3).any()
    assert (second.must_points.forces < 0.75 * first.must_points.forces).all()
