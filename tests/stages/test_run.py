"""run: the same files whoever solves; a failure leaves its log and nothing half-made."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from limbcli.errors import CaseError, SolveError, ToolError
from limbcli.feb.outline import Outline
from limbcli.feb.read import read_feb
from limbcli.results import open_stage, read_result
from limbcli.solvers.solver import Simulation, Table
from limbcli.stages.run import RunOptions, run, run_file
from limbcli.stages.running.files import curve_warnings, write_simulation
from tests.stages.block_case import make_case

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"
FILES = {
    "model.feb", "model.log", "rigid_body.csv", "nodes.csv", "elements.csv",
    "force-depth.csv", "force-depth.png", "run.json", "progress.jsonl",
}  # fmt: skip


@pytest.fixture
def febio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "febio4"
    path.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{DATA / 'fake_febio.py'}' \"$@\"\n")
    path.chmod(0o755)
    return path


def rows(path: Path) -> list[dict[str, float]]:
    with path.open() as stream:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]


def test_febios_run_leaves_all_files(febio: Path, tmp_path: Path) -> None:
    result = run_file(DATA / "punch.feb", out=tmp_path / "out", febio=febio)
    assert {each.name for each in result.folder.iterdir()} >= FILES
    assert (result.data["solver"], result.data["solver_version"]) == ("febio", "4.9.1")
    assert (result.data["linear_solver"], result.data["n_iterations"]) == ("pardiso", 12)
    table = rows(result.path("force_depth"))
    assert list(table[0]) == ["time_s", "depth_mm", "force_n"]
    assert [row["time_s"] for row in table] == [0.25, 0.5, 1]
    assert table[-1] == {"time_s": 1, "depth_mm": 2, "force_n": 0.8}
    assert [each["time_s"] for each in result.data["levels"]] == [0.25, 0.5, 1]
    assert json.loads((result.folder / "run.json").read_text())["data"]["max_force_n"] == 0.8


def test_febios_plot_file_is_kept_on_request(febio: Path, tmp_path: Path) -> None:
    plain = run_file(DATA / "punch.feb", out=tmp_path / "a", febio=febio)
    assert not list(plain.folder.glob("*.xplt"))
    kept = run_file(DATA / "punch.feb", out=tmp_path / "b", febio=febio, options=RunOptions(keep_plot=True))
    assert kept.path("plot").read_bytes() == b"plot of this run"
    assert [each.name for each in kept.folder.glob("*.xplt")] == ["model.xplt"]
    with pytest.raises(CaseError, match="writes no plot file"):
        run_file(
            DATA / "punch.feb", out=tmp_path / "c", solver="reference", options=RunOptions(keep_plot=True)
        )


@pytest.mark.slow
def test_both_solvers_leave_the_same_files(febio: Path, tmp_path: Path) -> None:
    one = run_file(DATA / "punch.feb", out=tmp_path / "a", febio=febio)
    two = run_file(DATA / "punch.feb", out=tmp_path / "b", solver="reference")
    names = [{each.name for each in result.folder.iterdir()} for result in (one, two)]
    assert names[1] == names[0] - {"threads.txt"}
    assert one.data.keys() == two.data.keys()
    assert [list(row) for row in rows(one.path("force_depth"))[:1]] == [
        list(row) for row in rows(two.path("force_depth"))[:1]
    ]
    assert two.data["levels"][-1]["depth_mm"] == pytest.approx(2.0)
    assert 0.3 < two.data["levels"][-1]["force_n"] < 2.0


@pytest.mark.slow
def test_a_case_is_run_with_its_measurement(tmp_path: Path) -> None:
    depths, forces = np.array([0.5, 1.2, 2.0]), np.array([0.2, 0.5, 1.0])
    case = make_case(tmp_path / "case", tmp_path / "out", depths, forces, c=0.005)
    result = run(case, out=tmp_path / "out", solver="reference", options=RunOptions(vtu=True))[0]
    assert {each.name for each in result.folder.iterdir()} >= FILES
    assert result.folder == tmp_path / "out" / "run" / "p1"
    levels = result.data["levels"]
    assert [each["depth_mm"] for each in levels] == pytest.approx(depths.tolist())
    assert (np.diff([each["force_n"] for each in levels]) > 0).all()
    assert set(result.provenance["inputs_sha256"]) == {"levels", "model"}

    steps = sorted((result.folder / "vtu").glob("*.vtu"))
    listed = (result.folder / "vtu" / "series.pvd").read_text()
    assert all(path.name in listed for path in steps)
    last = meshio.read(steps[-1])
    assert np.isfinite(last.point_data["displacement"]).all()
    model = read_feb(result.path("feb"))
    body = model.bodies[0]
    probe = np.unique(np.concatenate([model.mesh.block(name).cells.ravel() for name in body.blocks]))
    assert np.allclose(last.point_data["displacement"][probe, 2], -2.0 - body.center_of_mass[2])
    assert np.allclose(last.point_data["displacement"][model.mesh.node_sets["fixed"]], 0)
    assert np.nanmin(np.concatenate(last.cell_data["J"])) > 0.5


def test_an_error_names_the_users_file_not_the_copy_that_is_run(tmp_path: Path) -> None:
    text = (DATA / "punch.feb").read_text()
    mine = tmp_path / "mine.feb"
    mine.write_text(text.replace("<node_data ", '<node_data node_set="skim" ', 1))
    with pytest.raises(CaseError) as caught:
        run_file(mine, out=tmp_path / "out", solver="reference")
    assert caught.value.where.startswith(str(mine))
    assert "partial" not in str(caught.value)


def test_a_failed_run_keeps_its_log_and_the_last_good_result(
    febio: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    run_file(DATA / "punch.feb", out=out, febio=febio)
    monkeypatch.setenv("FAKE_FEBIO", "failed")
    with pytest.raises(SolveError, match="12 negative jacobians") as caught:
        run_file(DATA / "punch.feb", out=out, febio=febio)
    assert str(out / "run-failed" / "model.log") in caught.value.where
    assert "E R R O R" in (out / "run-failed" / "model.log").read_text()
    assert (out / "run-failed" / "model.feb").is_file()
    reported = json.loads((out / "run-failed" / "run.json").read_text())
    assert reported["data"]["failed"] is True
    assert "12 negative jacobians" in reported["data"]["failure"]["what"]
    assert reported["provenance"]["inputs_sha256"]["model"]
    assert all((out / "run-failed" / file).is_file() for file in reported["files"].values())
    assert read_result(out, "run").data["max_force_n"] == 0.8
    assert not [each for each in out.iterdir() if each.name.startswith(".partial")]


def test_a_files_run_does_not_replace_those_of_a_case(febio: Path, tmp_path: Path) -> None:
    kept = tmp_path / "out" / "run" / "p1" / "run.json"
    kept.parent.mkdir(parents=True)
    kept.write_text("{}")
    (tmp_path / "meshed" / "mesh").mkdir(parents=True)
    for name in ("out", "meshed"):
        with pytest.raises(CaseError, match="results of a case") as caught:
            run_file(DATA / "punch.feb", out=tmp_path / name, febio=febio)
        assert "--out" in caught.value.fix
    assert kept.is_file()


def test_the_time_limit_reaches_the_solver(
    febio: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "hang")
    with pytest.raises(SolveError, match=r"after 0\.5 s"):
        run_file(DATA / "punch.feb", out=tmp_path, febio=febio, options=RunOptions(time_limit_s=0.5))


def test_a_model_without_rigid_records_gives_no_curve(febio: Path, tmp_path: Path) -> None:
    text = (DATA / "punch.feb").read_text()
    start, end = text.index("<rigid_body_data"), text.index("<node_data")
    (tmp_path / "bare.feb").write_text(text[:start] + text[end:])
    result = run_file(tmp_path / "bare.feb", out=tmp_path / "out", febio=febio)
    assert "force_depth" not in result.files
    assert "no force-depth curve" in result.warnings[0]


def test_steps_of_a_model_without_records_are_counted_by_the_log(febio: Path, tmp_path: Path) -> None:
    text = (DATA / "punch.feb").read_text()
    start, end = text.index("<logfile"), text.index("</logfile>")
    (tmp_path / "mute.feb").write_text(text[:start] + text[end + len("</logfile>") :])
    result = run_file(tmp_path / "mute.feb", out=tmp_path / "out", febio=febio)
    assert result.data["n_steps"] == 3
    assert "3 steps" in result.summary[0]


def test_a_curve_of_an_uncertain_body_is_told() -> None:

    def simulated(**heights: float) -> Simulation:
        times = np.array([0.0, 1.0])
        tables = {
            name: Table(("z", "Fz"), times, np.zeros(1, int), np.array([[[z, 0.0]], [[z - 2, -0.8]]]))
            for name, z in heights.items()
        }
        return Simulation("febio", "4.11.0", times, tables)

    assert curve_warnings(simulated(probe=20.0), "probe") == []
    assert curve_warnings(simulated(bone=0.0, probe=-0.2), "probe") == []
    assert curve_warnings(simulated(head=0.0), "head") == []
    (other,) = curve_warnings(simulated(bone=0.0, head=0.0), "bone")
    assert "the curve is that of bone" in other


def test_the_greatest_depth_is_not_the_last_where_the_probe_is_lifted(tmp_path: Path) -> None:
    times = np.linspace(0, 1, 5)
    values = np.array([(0.0, 0.0), (-1.0, -1.0), (-2.0, -3.0), (-1.0, 0.0), (-0.5, 0.0)])[:, None]
    table = Table(("z", "Fz"), times, np.zeros(1, dtype=int), values)
    simulation = Simulation("reference", "1", times, {"probe": table})
    outline = Outline(
        1.0, (), np.zeros(1, dtype=int), np.zeros(1, dtype=int), (0.5, 1.0), has_touch_frame=True
    )
    with open_stage(tmp_path, "run", subject="lifted") as writer:
        write_simulation(simulation, outline, writer)
    assert (writer.data["max_depth_mm"], writer.data["max_force_n"]) == (2.0, 3.0)


def foreign(
    tmp_path: Path,
    fields: str,
    rows: list[tuple[float, ...]],
    warnings: tuple[str, ...] = (),
    version: str = "4.11.0",
):
    """The result of a run of a model file that is not limbcli's, from the rows of its only body."""
    times = np.linspace(0, 1, len(rows))
    table = Table(tuple(fields.split(";")), times, np.zeros(1, dtype=int), np.array(rows)[:, None])
    simulation = Simulation("febio", version, times, {"plate": table}, warnings=warnings)
    with open_stage(tmp_path, "run", subject="foreign") as writer:
        write_simulation(simulation, Outline(1.0, (), np.zeros(1, int), np.zeros(1, int), ()), writer)
    return writer


@pytest.mark.parametrize(
    ("version", "told"),
    [("4.8.0", True), ("4.9.0", False), ("4.11.0.65622b536", False), ("4.12.0", True), ("5.0", True)],
)
def test_a_febio_that_was_not_compared_is_told(tmp_path: Path, version: str, told: bool) -> None:
    writer = foreign(tmp_path, "z;Fz", [(1.5, 0.0), (1.0, -1.0)], version=version)
    assert any(f"FEBio {version} has not been compared" in each for each in writer.warnings) == told


@pytest.mark.parametrize(("version", "told"), [("4.9.0", True), ("4.11.0", False)])
def test_reactions_that_an_older_febio_repeats_are_told(tmp_path: Path, version: str, told: bool) -> None:
    times = np.array([0.0, 1.0])
    nodes = Table(("uz", "Rz"), times, np.arange(4), np.full((2, 4, 2), -0.08))
    simulation = Simulation("febio", version, times, {}, nodes={"nodes.csv": nodes})
    with open_stage(tmp_path, "run", subject="foreign") as writer:
        write_simulation(simulation, Outline(1.0, (), np.zeros(1, int), np.zeros(1, int), ()), writer)
    assert any("at each of its nodes" in each for each in writer.warnings) == told


def test_depth_in_a_foreign_model_is_the_travel_since_first_contact(tmp_path: Path) -> None:
    """The plate's centre begins 1.5 mm above z = 0 and touches at 1.0; the force is linear from there."""
    heights = (1.5, 1.2, 0.9, 0.6)
    writer = foreign(tmp_path, "z;Fz", [(z, -2.0 * max(0.0, 1.0 - z)) for z in heights])
    assert writer.data["max_depth_mm"] == pytest.approx(0.4)
    assert writer.data["max_force_n"] == pytest.approx(0.8)
    assert any("0.5 mm from its start" in each for each in writer.summary)


def test_a_foreign_body_may_press_along_any_axis(tmp_path: Path) -> None:
    rows = [(x, 0.3, 0.1 * x, 0.0) for x in (0.0, 0.5, 1.0)]
    writer = foreign(tmp_path, "x;z;Fx;Fz", rows)
    assert writer.data["max_depth_mm"] == pytest.approx(1.0)
    assert writer.data["max_force_n"] == pytest.approx(0.1)


def test_a_plate_that_nothing_touches_is_told_with_febios_warning(tmp_path: Path) -> None:
    rows = [(1.0, 0.0), (0.95, 0.0), (0.9, -1e-20)]
    writer = foreign(tmp_path, "z;Fz", rows, warnings=("No force acting on the system.",) * 2)
    assert writer.data["max_depth_mm"] == pytest.approx(0.1)
    assert "febio warns (2 times): No force acting on the system." in writer.warnings
    assert any("no force acts on plate in any step" in each for each in writer.warnings)


@pytest.mark.slow
def test_warnings_of_febios_log_are_those_of_the_run(febio: Path, tmp_path: Path) -> None:
    """Not those that the settings of limbcli's own models cause."""
    text = (DATA / "punch.feb").read_text()
    (tmp_path / "own.feb").write_text(text)
    (tmp_path / "other.feb").write_text(text.replace("limbcli-info", "info"))
    own = run_file(tmp_path / "own.feb", out=tmp_path / "own", febio=febio)
    other = run_file(tmp_path / "other.feb", out=tmp_path / "other", febio=febio)
    words = 'febio warns: Zero mass for rigid body "probe."'
    assert words in other.warnings
    assert words not in own.warnings


@pytest.mark.slow
def test_a_rigid_primary_surface_is_told_before_febio_runs(febio: Path, tmp_path: Path) -> None:
    text = (DATA / "punch.feb").read_text()
    pair = "<primary>skin</primary><secondary>probe_face</secondary>"
    turned = text.replace(pair, "<primary>probe_face</primary><secondary>skin</secondary>")
    assert turned != text
    (tmp_path / "turned.feb").write_text(turned)
    with pytest.raises(CaseError, match="'probe_face' is on rigid shells without volume") as caught:
        run_file(tmp_path / "turned.feb", out=tmp_path / "out", febio=febio)
    assert "soft surface" in caught.value.fix
    for allowed in (
        turned.replace("<auto_penalty>1", "<auto_penalty>0"),
        turned.replace("<two_pass>0", "<two_pass>1"),
        turned.replace('<ShellDomain name="probe" mat="probe"/>',
                       '<ShellDomain name="probe" mat="probe"><shell_thickness>0.1</shell_thickness>'
                       "</ShellDomain>"),
    ):  # fmt: skip
        assert allowed != turned
        (tmp_path / "allowed.feb").write_text(allowed)
        run_file(tmp_path / "allowed.feb", out=tmp_path / "out", febio=febio)


def test_febio_runs_what_the_reader_would_refuse(febio: Path, tmp_path: Path) -> None:
    text = (DATA / "punch.feb").read_text().replace("<Boundary>", "<Constraints><c/></Constraints><Boundary>")
    (tmp_path / "odd.feb").write_text(text)
    assert run_file(tmp_path / "odd.feb", out=tmp_path / "out", febio=febio).data["max_force_n"] == 0.8
    with pytest.raises(CaseError, match="Constraints"):
        run_file(tmp_path / "odd.feb", out=tmp_path / "out", solver="reference")
    febio.write_text('#!/bin/sh\ntouch "$0.started"\n')
    with pytest.raises(CaseError, match="without --vtu"):  # which needs to read it, too; said before the run
        run_file(tmp_path / "odd.feb", out=tmp_path / "out", febio=febio, options=RunOptions(vtu=True))
    assert not febio.with_name("febio4.started").exists()


def test_missing_pieces_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CaseError, match="does not exist"):
        run_file(tmp_path / "no.feb", out=tmp_path)
    with pytest.raises(ToolError, match="not found"):
        run_file(DATA / "punch.feb", out=tmp_path, febio=tmp_path / "no")
    shutil.copy(DATA / "README.md", tmp_path / "text.feb")
    with pytest.raises(CaseError, match="not a readable XML"):
        run_file(tmp_path / "text.feb", out=tmp_path, solver="reference")
