"""Poroelasticity in a diagnosis: evaluated with FEBio where holds were recorded, else told why it is not."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from limbcli.cli.app import main
from limbcli.diagnosis.data.held_forces import HeldForces
from limbcli.diagnosis.drainage import DrainageSolver, drained
from limbcli.diagnosis.mesh_error.numerical_checks import Notes
from limbcli.effects import poroelasticity
from limbcli.effects.curves import Curves
from limbcli.effects.effect import Effect
from limbcli.errors import LimbError, SolveError
from limbcli.feb.read import read_feb
from limbcli.model import LimbModel
from limbcli.progress import SILENT
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.solver import Simulation, Table
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from tests.stages import block_case as block
from tests.stages import draining_case

CURVES = Curves(np.linspace(0, 10, 21), 0.4 * np.linspace(0, 10, 21) ** 1.5, np.zeros((21, 0)), np.zeros(0))
NAMES = ("poroelasticity", "viscoelasticity", "force-zero", "depth-zero")


@dataclass
class Pretending:
    """A solver whose tissue loses a tenth of its force, and that fails at depths (mm) beyond `reach`, and in
    longer first steps than `longest` (mm)."""

    reach: float = 100.0
    longest: float = 100.0
    name: str = "febio"
    requested: list[float] = field(default_factory=list)

    def found(self) -> bool:
        return True

    def version(self) -> str:
        return "4.0"

    def write(self, model: LimbModel, folder: Path) -> Path:
        (_, _), (ramp, depth) = model.curves["probe_travel"].points[:2]
        first = model.curves["longest_step"].points[0][1] / ramp * depth
        (folder / "depth").write_text(f"{depth!r} {float(first)!r}")
        return folder / "model.feb"

    def run(self, feb: Path, *, progress, time_limit_s=None) -> None:
        depth, first = map(float, (feb.parent / "depth").read_text().split())
        self.requested.append(depth)
        if depth > self.reach or first > self.longest:
            raise SolveError("FEBio stopped with an error", where=str(feb), fix="none")

    def read(self, feb: Path) -> Simulation:
        time = np.r_[0.0, np.geomspace(0.001, 3000.0, 40)]
        force = np.where(time > 0, 1.0 - 0.1 * (1.0 - np.exp(-time / 10.0)), 0.0)
        table = Table(("z", "Fz"), time, np.zeros(1, int), np.stack([0 * force, -force], axis=1)[:, None])
        return Simulation("febio", "4.0", time, {"probe": table})


class Book:
    """A block, and curves of it."""

    model, c = block.block_model("tet10", counts=(4, 2, 2)), 0.006

    def curves(self, m: float) -> Curves:
        return CURVES


def held(fall: float) -> HeldForces:
    depth = np.r_[np.zeros(20), np.full(80, 4.0)]
    return HeldForces(depth, np.array([[(24, 34), (84, 94)]] * 2), np.full(2, fall), 0.004**2 * np.eye(2))


def drained_by(
    solver: Pretending, keep: Path, data: HeldForces | None, *, always: bool = True
) -> tuple[Effect, Notes]:
    notes = Notes({"holds_not_used": "no trace"})
    found = drained(
        DrainageSolver(solver, always), data, Book(), deepest=4.0, keep=keep, notes=notes, progress=SILENT
    )
    return found, notes


def test_what_drains_is_simulated_once_and_kept(tmp_path):
    solver = Pretending()
    effect, notes = drained_by(solver, tmp_path, held(0.1))
    assert sorted(solver.requested) == pytest.approx([0.8, 1.8, 3.8], abs=0.21)
    assert not effect.febio_only
    assert not effect.solves
    assert [each["depth_mm"] for each in notes.data["drainage"]["runs"]] == [4.0, 2.0, 1.0]
    assert notes.data["drainage"]["solver_version"] == "4.0"
    again = Pretending()
    drained_by(again, tmp_path, held(0.1))
    assert again.requested == []


def test_what_fails_is_tried_again_in_shorter_steps(tmp_path):
    solver = Pretending(longest=0.2)
    _, notes = drained_by(solver, tmp_path, held(0.1))
    assert not notes.warnings
    assert len(solver.requested) == 6
    assert [each["problem"] for each in notes.data["drainage"]["runs"]] == [None] * 3


def test_a_depth_without_an_answer_is_told_and_two_refuse(tmp_path):
    _, notes = drained_by(Pretending(reach=3.0), tmp_path, held(0.1))
    assert "without FEBio's run at 4 mm: FEBio stopped with an error" in notes.warnings[0]
    with pytest.raises(LimbError, match="at only 1 of 3 depths: FEBio stopped"):
        drained_by(Pretending(reach=1.5), tmp_path / "other", held(0.1))
    with pytest.raises(LimbError, match="at only 0 of 3 depths"):
        drained_by(Pretending(reach=0.0), tmp_path / "none", held(0.1))


def test_without_holds_or_fall_nothing_is_simulated(tmp_path):
    solver = Pretending()
    with pytest.raises(LimbError, match=r"hold \(no trace\)"):
        drained_by(solver, tmp_path, None)
    with pytest.raises(LimbError, match="no force decrease"):
        drained_by(solver, tmp_path, held(0.0), always=False)
    assert solver.requested == []
    drained_by(solver, tmp_path, held(0.1), always=False)


def test_febio_that_is_not_there_is_exit_code_4(capsys, tmp_path):
    case = Path(__file__).parents[2] / "cases" / "phantom"
    with pytest.raises(SystemExit) as stop:
        main(["diagnose", str(case), "--out", str(tmp_path), "--solver", "febio", "--febio", "nowhere"])
    assert stop.value.code == 4
    assert "FEBio was not found at nowhere" in capsys.readouterr().err


# ---------------------------------------------------------------- the whole stage


@pytest.mark.slow
def test_a_febio_that_crashes_leaves_it_not_evaluated(tmp_path, rng):
    binary = tmp_path / "febio4"
    binary.write_text("#!/bin/sh\nexit 1\n")
    binary.chmod(0o755)
    stairs = draining_case.Staircase((1.0, 2.0, 3.0), c=0.03)
    time = np.array([0.0, 1.0, 13.0, 14.0, 26.0, 27.0, 39.0])
    force = np.array([0.0, 1.1, 1.0, 2.3, 2.1, 4.4, 4.1])
    working = block.block_model("tet10", counts=(4, 2, 2))
    case = draining_case.make_case(
        tmp_path / "case", tmp_path / "out", stairs, time, force, np.full(4, 3.9), working, rng
    )
    options = DiagnoseOptions(effects=NAMES, interventions=False, solver="febio", febio=binary)
    (found,) = diagnose(case, out=tmp_path / "out", options=options)
    content = json.loads(found.path("diagnosis").read_text())
    assert "FEBio" in content["not_evaluated"]["poroelasticity"]
    assert all(each["problem"] for each in content["drainage"]["runs"])


@pytest.mark.slow
@pytest.mark.febio
@pytest.mark.skipif(not FebioSolver().found(), reason="needs FEBio 4: set LIMBCLI_FEBIO to its binary")
def test_drainage_that_febio_made_is_found_with_its_permeability(tmp_path, rng):
    """Data of FEBio's run along the whole staircase on a finer mesh; diagnosed on a coarse one."""
    fine, working = (block.block_model("tet10", counts=counts) for counts in ((8, 6, 3), (6, 4, 2)))
    stairs = draining_case.Staircase((0.8, 1.4, 2.0, 2.5, 3.0, 3.4, 3.8))
    time, force = stairs.by_febio(fine, tmp_path / "febio")
    speed, out = draining_case.speeds(fine, stairs), tmp_path / "out"
    case = draining_case.make_case(tmp_path / "case", out, stairs, time, force, speed, working, rng)
    options = DiagnoseOptions(effects=NAMES, interventions=False, solver="febio")
    (found,) = diagnose(case, out=out, options=options)
    content = json.loads(found.path("diagnosis").read_text())
    assert content["verdict"] in ("named", "ambiguous")
    assert ["poroelasticity"] in content["confidence_set"]
    assert not content["not_evaluated"]
    alone = next(each for each in content["explanations"] if each["explanation"] == ["poroelasticity"])
    k = poroelasticity.permeability(alone["values"])
    assert stairs.k / 3 < k < 3 * stairs.k
    if content["added"] == ["poroelasticity"]:
        ends = content["shrink"][-1]["intervals_95"][poroelasticity.PERMEABILITY.name]
        low, high = (poroelasticity.permeability({poroelasticity.PERMEABILITY.name: x}) for x in ends)
        assert low < stairs.k < high
        assert read_feb(found.path("feb")).materials["tissue"].law == "biphasic"
    (again,) = diagnose(case, out=out, options=options)
    kept = json.loads(again.path("diagnosis").read_text())
    assert kept["drainage"] == content["drainage"]  # its seconds too: nothing was run again
