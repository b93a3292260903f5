"""FEBio is found, watched, stopped and judged by its log (a surrogate program replays stored logs)."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError, SolveError, ToolError
from limbcli.feb.outline import Outline
from limbcli.feb.read import read_feb
from limbcli.progress import SILENT, Progress
from limbcli.solvers import ABSENT, choose, identity
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.febio_watch import default_limit_s
from limbcli.stages.batching.outcome import BatchOptions

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"


@pytest.fixture
def binary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The surrogate as a program that can be started."""
    path = tmp_path / "bin" / "febio4"
    path.parent.mkdir()
    path.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{DATA / 'fake_febio.py'}' \"$@\"\n")
    path.chmod(0o755)
    monkeypatch.delenv("LIMBCLI_FEBIO", raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    return path


@pytest.fixture
def feb(tmp_path: Path) -> Path:
    path = tmp_path / "work" / "model.feb"
    path.parent.mkdir()
    shutil.copy(DATA / "punch.feb", path)
    return path


def is_alive(pid: int) -> bool:
    """Whether a process still runs after some time to die (one that is only not yet collected does not)."""
    for _ in range(200):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            return False
        if state == "Z":
            return False
        time.sleep(0.02)
    return True


def test_a_complete_run_is_read(binary: Path, feb: Path) -> None:
    solver = FebioSolver(binary, threads=3)
    seen: list[dict[str, float]] = []
    solver.run(feb, progress=Progress(lambda kind, facts: seen.append({"kind": kind, **facts})))
    simulation = solver.read(feb)
    assert (simulation.solver, simulation.version, simulation.linear_solver) == ("febio", "4.9.1", "pardiso")
    assert simulation.times.tolist() == [0, 0.25, 0.5, 1]
    assert np.allclose(simulation.probe_force(), [0, 0.2, 0.4, 0.8])
    assert np.allclose(simulation.probe_depth()[-1], 2.0)
    assert (simulation.n_iterations, simulation.n_factorisations, simulation.seconds) == (12, 3, 2.125)
    nodes = simulation.nodes["nodes.csv"]
    assert np.array_equal(nodes.items, np.arange(50, 75))
    assert simulation.elements["elements.csv"].column("J").shape == (4, 196)
    assert (feb.parent / "threads.txt").read_text() == "3"
    newton = [each for each in seen if each["kind"] == "newton"]
    assert len(newton) >= 2, "iterations are told while the log grows"
    assert newton[-1]["step"] == newton[-1]["n_steps"] == 3


def test_only_what_was_asked_for_is_left(binary: Path, feb: Path) -> None:
    (feb.parent / "mine.xplt").write_bytes(b"of another run")
    FebioSolver(binary).run(feb, progress=SILENT)
    assert {path.name for path in feb.parent.iterdir()} == {
        "model.feb", "model.log", "rigid_body.csv", "nodes.csv", "elements.csv", "mine.xplt", "threads.txt",
    }  # fmt: skip


def test_the_version_is_asked_for(binary: Path) -> None:
    assert FebioSolver(binary).version() == "4.9.1"


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="other systems tell no child that it is alone"
)
def test_febio_ends_with_a_limbcli_that_is_killed(binary: Path, feb: Path) -> None:
    runs = (
        "import sys; from pathlib import Path; from limbcli.progress import SILENT; "
        "from limbcli.solvers.febio import FebioSolver; "
        "FebioSolver(Path(sys.argv[1])).run(Path(sys.argv[2]), progress=SILENT)"
    )
    killed = subprocess.Popen(
        [sys.executable, "-c", runs, binary, feb], env={**os.environ, "FAKE_FEBIO": "hang"}
    )
    for _ in range(1000):
        if (child := started_child(feb)) is not None:
            break
        time.sleep(0.02)
    assert child is not None
    febio = int(Path(f"/proc/{child}/stat").read_text().rsplit(")", 1)[1].split()[1])
    killed.kill()
    killed.wait()
    assert not is_alive(febio)
    os.kill(child, signal.SIGKILL)


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("failed", "stopped with an error at time 0.25"),
        ("lies good", "stopped with an error at time 0.25"),
        ("truncated", "ends abruptly at time 0.5"),
        ("no log", r"status 127 and wrote no log(.|\n)*libmkl_rt"),
    ],
)
def test_a_run_that_did_not_end_well_raises_whatever_the_exit_status(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch, mode: str, words: str
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", mode)
    with pytest.raises(SolveError, match=words):
        FebioSolver(binary).run(feb, progress=SILENT)
    if mode != "no log":
        with pytest.raises(SolveError):
            FebioSolver(binary).read(feb)


def test_a_bad_exit_status_does_not_spoil_a_good_log(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "lies bad")
    FebioSolver(binary).run(feb, progress=SILENT)
    assert FebioSolver(binary).read(feb).times[-1] == 1


def test_an_old_log_does_not_count(binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FebioSolver(binary).run(feb, progress=SILENT)
    monkeypatch.setenv("FAKE_FEBIO", "no log")
    with pytest.raises(SolveError, match="wrote no log"):
        FebioSolver(binary).run(feb, progress=SILENT)


def started_child(feb: Path) -> int | None:
    """The process that the surrogate started, once it has."""
    path = feb.parent / "child.pid"
    text = path.read_text() if path.is_file() else ""
    return int(text) if text else None


@pytest.mark.slow
def test_a_febio_that_does_not_end_after_its_log_is_ended_and_its_run_counts(binary, feb, monkeypatch):
    monkeypatch.setenv("FAKE_FEBIO", "lingers")
    monkeypatch.setattr("limbcli.solvers.febio.LINGERS_S", 0.3)
    start = time.monotonic()
    FebioSolver(binary).run(feb, progress=SILENT, time_limit_s=60)
    assert time.monotonic() - start < 30
    assert FebioSolver(binary).read(feb).times[-1] == 1


def test_the_time_limit_stops_febio_and_what_it_started(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "hang")
    clock = time.monotonic
    monkeypatch.setattr(
        "limbcli.solvers.febio.time.monotonic", lambda: clock() + 1e6 * (started_child(feb) is not None)
    )
    with pytest.raises(SolveError, match=r"stopped after 1000 s, at time 0\.5") as caught:
        FebioSolver(binary).run(feb, progress=SILENT, time_limit_s=1000)
    assert "--time-limit-s" in caught.value.fix
    child = started_child(feb)
    assert child is not None
    assert not is_alive(child)


def test_an_interruption_stops_febio_and_what_it_started(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "hang")
    sleep = time.sleep

    def sleep_then_interrupt(seconds: float) -> None:
        if threading.current_thread() is threading.main_thread() and started_child(feb) is not None:
            raise KeyboardInterrupt
        sleep(seconds)

    with monkeypatch.context() as patched:
        patched.setattr("limbcli.solvers.febio.time.sleep", sleep_then_interrupt)
        with pytest.raises(KeyboardInterrupt):
            FebioSolver(binary).run(feb, progress=SILENT)
    child = started_child(feb)
    assert child is not None
    assert not is_alive(child)


def test_a_binary_that_is_absent_or_no_program_is_a_tool_error(
    tmp_path: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("LIMBCLI_FEBIO", raising=False)
    with pytest.raises(ToolError, match="not found at"):
        FebioSolver(tmp_path / "nothing").run(feb, progress=SILENT)
    broken = tmp_path / "broken"
    broken.write_bytes(b"\x7fELF not really")
    broken.chmod(0o755)
    with pytest.raises(ToolError, match="cannot be started"):
        FebioSolver(broken).run(feb, progress=SILENT)


def test_the_binary_is_looked_for_by_option_then_variable_then_path(
    binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not FebioSolver().found()
    monkeypatch.setenv("PATH", str(binary.parent))
    assert FebioSolver().path() == binary
    other = tmp_path / "other"
    shutil.copy(binary, other)
    monkeypatch.setenv("LIMBCLI_FEBIO", str(other))
    assert FebioSolver().path() == other
    assert FebioSolver(binary).path() == binary


def test_a_file_from_here_comes_before_a_program_of_that_name(
    binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--febio ./febio4` is `febio4` once it is a path."""
    monkeypatch.setenv("PATH", str(binary.parent))
    monkeypatch.chdir(tmp_path)
    assert FebioSolver(Path("febio4")).path() == binary
    assert BatchOptions.of(febio=Path("febio4"), templates=None).febio == Path("febio4")
    own = Path(shutil.copy(binary, tmp_path / "febio4"))
    assert FebioSolver(Path("./febio4")).path() == own
    assert BatchOptions.of(febio=Path("./febio4"), templates=None).febio == own
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("LIMBCLI_FEBIO", "~/febio4")
    assert FebioSolver().path() == own
    own.chmod(0o644)
    with pytest.raises(ToolError, match="is not executable"):
        FebioSolver().need()
    with pytest.raises(ToolError, match="is a folder"):
        FebioSolver(binary.parent).need()


def test_choose_takes_febio_where_it_is_and_refuses_to_pretend(
    binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert choose("auto").name == "reference"
    assert choose("auto", binary).name == "febio"
    assert choose("reference", binary).name == "reference"
    with pytest.raises(ToolError, match="FEBio was not found"):
        choose("febio")
    with pytest.raises(ToolError, match="nothing"):
        choose("auto", tmp_path / "nothing")
    with pytest.raises(CaseError, match="no solver 'abaqus'"):
        choose("abaqus")
    monkeypatch.setenv("PATH", str(binary.parent))
    assert choose("auto").name == "febio"
    monkeypatch.setenv("LIMBCLI_FEBIO", str(tmp_path / "elsewhere"))
    with pytest.raises(ToolError, match="elsewhere"):
        choose("auto")
    assert choose("reference").name == "reference"
    assert {identity("auto"), identity("abaqus")} == {ABSENT}  # no reason for a key to fail


def test_what_febio_writes_it_reads(tmp_path: Path) -> None:
    model = read_feb(DATA / "punch.feb")
    path = FebioSolver().write(model, tmp_path)
    assert path.name == "model.feb"
    assert np.array_equal(read_feb(path).mesh.points, model.mesh.points)


def test_stored_results_of_febio_become_a_simulation(golden: Path, tmp_path: Path) -> None:
    folder = golden / "log-normal"
    text = next((golden / "effect-base-tet4").glob("model.feb")).read_text()
    start, end = text.index("<node_data"), text.index("</logfile>")
    (tmp_path / "model.feb").write_text(text[:start] + text[end:])
    for name in ("model.log", "rigid_body.csv"):
        shutil.copy(folder / name, tmp_path / name)
    simulation = FebioSolver().read(tmp_path / "model.feb")
    assert simulation.version == "4.11.0"
    assert simulation.probe_force()[-1] == pytest.approx(0.884407, rel=1e-5)
    assert simulation.probe_depth()[-1] == 6.0
    shutil.copy(golden / "log-killed" / "model.log", tmp_path / "model.log")
    with pytest.raises(SolveError, match="ends abruptly"):
        FebioSolver().read(tmp_path / "model.feb")


def test_a_binary_that_serves_another_run_s_log_is_not_believed(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "other run")
    with pytest.raises(SolveError, match="of another run"):
        FebioSolver(binary).run(feb, progress=SILENT)


def test_results_beside_a_changed_model_file_are_not_read(binary: Path, feb: Path) -> None:
    solver = FebioSolver(binary)
    solver.run(feb, progress=SILENT)
    feb.write_text(feb.read_text().replace("<c1>0.0025", "<c1>0.0050"))
    with pytest.raises(SolveError, match="another model file"):
        solver.read(feb)


def test_a_version_probe_that_hangs_ends_soon(binary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "hang at once")
    monkeypatch.setattr("limbcli.solvers.febio._VERSION_TIMEOUT_S", 0.3)
    start = time.monotonic()
    assert FebioSolver(binary).version() == "unknown"
    assert time.monotonic() - start < 5


@pytest.mark.slow
def test_a_silent_run_gives_signs_of_life_and_ends_by_the_limit_of_its_size(
    binary: Path, feb: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_FEBIO", "hang")
    monkeypatch.setattr("limbcli.solvers.febio.HEARTBEAT_S", 0.2)
    monkeypatch.setattr("limbcli.solvers.febio_watch._LEAST_LIMIT_S", 2.0)
    monkeypatch.setattr("limbcli.solvers.febio_watch._LIMIT_S_PER_NODE_AND_LEVEL", 0.0)
    seen: list[tuple[str, dict]] = []
    with pytest.raises(SolveError, match="the limit for a model of this size"):
        FebioSolver(binary).run(feb, progress=Progress(lambda kind, facts: seen.append((kind, facts))))
    alive = [facts for kind, facts in seen if kind == "alive"]
    assert len(alive) >= 2
    assert alive[-1]["seconds"] > alive[0]["seconds"]
    assert (alive[-1]["limit_s"], alive[-1]["end_time"]) == (2.0, 1.0)


def test_a_model_s_own_limit_grows_with_nodes_and_levels() -> None:
    def limit(n_nodes: int, n_levels: int) -> float:
        times = tuple(float(each) for each in range(1, n_levels + 1))
        return default_limit_s(Outline(1.0, (), np.arange(n_nodes), np.zeros(0, np.int64), times))

    assert limit(100, 5) == limit(200, 5)
    assert limit(60_000, 20) == pytest.approx(4 * limit(30_000, 10))
    assert limit(30_000, 10) > 3600


@pytest.mark.parametrize(
    ("level", "words"),
    [("OUTPUT_MINOR_ITRS", "has not converged"), ("2", "has not converged"), ("OUTPUT_NEVER", "empty")],
)
def test_records_of_unconverged_iterations_are_not_asked_for(
    binary: Path, feb: Path, level: str, words: str
) -> None:
    control = f"<step_size>0.1</step_size><output_level>{level}</output_level>"
    feb.write_text(feb.read_text().replace("<step_size>0.1</step_size>", control))
    with pytest.raises(CaseError, match=words):
        FebioSolver(binary).run(feb, progress=SILENT)
    feb.write_text(feb.read_text().replace(f"{level}</output_level>", "OUTPUT_MUST_POINTS</output_level>"))
    FebioSolver(binary).run(feb, progress=SILENT)


def test_records_with_a_step_twice_are_not_believed(binary: Path, feb: Path) -> None:
    FebioSolver(binary).run(feb, progress=SILENT)
    table = feb.parent / "rigid_body.csv"
    text = table.read_text().replace("*Time  = 0.25", "*Time  = 0.5")
    table.write_text(text)  # two steps whose times differ in no digit that is printed
    for other in ("nodes.csv", "elements.csv"):
        (feb.parent / other).write_text((feb.parent / other).read_text().replace("= 0.25", "= 0.5"))
    assert FebioSolver(binary).read(feb).times.tolist() == [0, 0.5, 0.5, 1]
    table.write_text(text.replace("*Step  = 1", "*Step  = 2"))
    with pytest.raises(SolveError, match=r"step at time 0\.5 appears more than once"):
        FebioSolver(binary).read(feb)
