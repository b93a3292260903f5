"""A stopped run goes on from its last level, if nothing has changed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.read import read_feb
from limbcli.progress import SILENT, Progress
from limbcli.solvers.reference import ReferenceSolver
from limbcli.solvers.restart import RESTART_FILE
from limbcli.solvers.session import ReferenceSession


@pytest.fixture
def feb(golden: Path, tmp_path: Path) -> Path:
    """Three levels of a coarse model."""
    text = (golden / "effect-base-tet4" / "model.feb").read_text()
    path = tmp_path / "model.feb"
    path.write_text(text.replace("<time_steps>10<", "<time_steps>3<"))
    return path


def stopped(feb: Path, after: int) -> list[int]:
    """Run until Ctrl-C in the level after so many; iterations of each level worked on."""
    seen: list[int] = []

    def listen(kind: str, facts: dict) -> None:
        if kind == "newton":
            if facts["step"] > after:
                raise KeyboardInterrupt
            if facts["iteration"]:
                seen.append(facts["step"])

    with pytest.raises(KeyboardInterrupt):
        ReferenceSolver(threads=1).run(feb, progress=Progress(listen))
    return seen


def worked(feb: Path) -> set[int]:
    """Levels that needed iterations in a run to the end."""
    seen = set()

    def listen(kind: str, facts: dict) -> None:
        if kind == "newton" and facts["iteration"]:
            seen.add(facts["step"])

    ReferenceSolver(threads=1).run(feb, progress=Progress(listen))
    return seen


def test_stopped_run_goes_on_and_gives_the_same_records(feb: Path) -> None:
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    whole = {name: (feb.parent / name).read_text() for name in ("nodes.csv", "rigid_body.csv")}
    assert not (feb.parent / RESTART_FILE).exists()
    assert set(stopped(feb, 2)) == {1, 2}
    assert worked(feb) == {3}
    assert not (feb.parent / RESTART_FILE).exists()
    simulation = solver.read(feb)
    assert len(simulation.times) == 4
    for name, text in whole.items():
        a, b = (
            np.array([float(n) for line in t.splitlines() if line[0] != "*" for n in line.split(",")])
            for t in (text, (feb.parent / name).read_text())
        )
        np.testing.assert_allclose(a, b, atol=2e-4 * abs(a).max())


def test_levels_that_a_session_solved_need_no_iteration_in_a_run(feb: Path) -> None:
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    forces = solver.read(feb).probe_force()
    with ReferenceSession(read_feb(feb), threads=1) as session:
        levels = session.solve().levels
    assert levels is not None
    solver.begin_with(feb, levels)
    assert worked(feb) == set()
    np.testing.assert_allclose(solver.read(feb).probe_force(), forces, atol=1e-5 * abs(forces).max())
    assert worked(feb) == {1, 2, 3}, "they lead one run"


def test_time_limit_leaves_a_level_to_go_on_from(feb: Path) -> None:
    with pytest.raises(SolveError, match="run again to resume"):
        ReferenceSolver(threads=1).run(feb, progress=SILENT, time_limit_s=0.0)
    assert worked(feb) == {2, 3}


def test_a_run_whose_last_level_took_longer_than_the_limit_is_a_whole_one(feb: Path) -> None:
    """As the first of all on a machine of one core, which compiles the solver in it."""
    feb.write_text(feb.read_text().replace("<time_steps>3<", "<time_steps>1<"))
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT, time_limit_s=0.0)
    assert len(solver.read(feb).times) == 2
    assert not (feb.parent / RESTART_FILE).exists()


def test_changed_model_starts_anew(feb: Path) -> None:
    stopped(feb, 2)
    feb.write_text(feb.read_text().replace("<cp>0.25<", "<cp>0.26<"))
    assert worked(feb) == {1, 2, 3}


def test_damaged_file_is_left_alone(feb: Path) -> None:
    stopped(feb, 2)
    path = feb.parent / RESTART_FILE
    path.write_bytes(path.read_bytes()[:300])
    assert worked(feb) == {1, 2, 3}
