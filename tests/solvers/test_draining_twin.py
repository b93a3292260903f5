"""Draining tissue as FEBio has it: against the closed form of a column, and against staircases of holds.

tests/data/febio-draining.json holds FEBio's numbers (its 4.11.0, built from source, MKL Pardiso, one thread);
`python -m tests.solvers.draining_models FEBIO` makes it again.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from limbcli.diagnosis.data.held_forces import STEP_S, relaxing
from limbcli.diagnosis.drainage import held_model, hold_of
from limbcli.effects.drainage import Drainage, HeldIndentation, held_memory
from limbcli.progress import SILENT
from limbcli.solvers.febio import FebioSolver
from tests.solvers import draining_models as asked
from tests.stages.block_case import block_model

FEBIO = json.loads(asked.FILE.read_text())
HOLDS = [
    HeldIndentation(
        each["depth_mm"], each["ramp_mm2"], np.array(each["spread_mm2"]), np.array(each["force_n"])
    )
    for each in FEBIO["holds"]
]


def test_a_confined_column_is_the_closed_form():
    """Pressed, and held. Steps of 0.5 s (backward Euler) smear the start, and the kink at the hold's."""
    time, force = (np.array(FEBIO["column"][key]) for key in ("time_s", "force_n"))
    later = time >= 10 * asked.STEP_S
    assert force[later] == pytest.approx(asked.closed_form(time[later]), abs=0.02 * force.max())
    assert force[-1] == pytest.approx(asked.closed_form(time[-1:])[0], rel=5e-4)


def undrained(hold: HeldIndentation, drainage: Drainage) -> float:
    """N, that the fitted terms say was there before anything had drained."""
    k = int(np.flatnonzero(drainage.depth == hold.depth)[0])
    left = 1.0 - (1.0 - held_memory(hold, drainage.spread)) @ drainage.lost[k]
    return float(np.median((hold.force / left)[hold.spread >= drainage.spread[0]]))


def test_the_terms_go_through_every_hold():
    drainage = Drainage.through(HOLDS)
    assert np.all(drainage.lost >= 0)
    for k, hold in enumerate(sorted(HOLDS, key=lambda each: each.depth)):
        used = hold.spread >= drainage.spread[0]
        left = 1.0 - (1.0 - held_memory(hold, drainage.spread)) @ drainage.lost[k]
        assert hold.force[used] / left[used] == pytest.approx(undrained(hold, drainage), rel=2e-3)


@pytest.mark.parametrize("found", FEBIO["stairs"], ids=lambda each: f"{each['k_c_mm2_per_s']} mm2/s")
def test_superposition_foretells_a_staircase_of_holds(found):
    """Forces of FEBio's run where a hold was simulated, and their fall in every hold."""
    rate, drainage = found["k_c_mm2_per_s"], Drainage.through(HOLDS)
    stairs = asked.STAIRS[rate]
    at = np.arange(0.0, found["time_s"][-1] + STEP_S / 2, STEP_S)
    depth = stairs.depth_at(at)
    memory = np.column_stack([relaxing(depth, tau) for tau in drainage.times(rate).tolist()])
    left, force = drainage.left(depth, memory, rate), np.interp(at, found["time_s"], found["force_n"])
    whole = {hold.depth: undrained(hold, drainage) for hold in HOLDS}
    for k, held_at in enumerate(stairs.depths):
        first = round((k * (1.0 + stairs.hold) + 1.0) / STEP_S)
        last = first + round(stairs.hold / STEP_S)
        fallen, foretold = (float(np.log(each[first] / each[last])) for each in (force, left))
        assert foretold == pytest.approx(fallen, abs=0.005)
        assert fallen > 0.015
        if held_at in whole:
            assert whole[held_at] * left[last] == pytest.approx(force[last], rel=0.007)


@pytest.mark.slow
@pytest.mark.febio
@pytest.mark.skipif(not FebioSolver().found(), reason="needs FEBio 4: set LIMBCLI_FEBIO to its binary")
def test_febio_still_says_so(tmp_path: Path):
    solver = FebioSolver(threads=1)
    column = asked.column_by(solver, tmp_path / "column")
    assert column["force_n"] == pytest.approx(FEBIO["column"]["force_n"], rel=1e-3, abs=1e-9)
    model = held_model(block_model("tet10", counts=(8, 6, 3)), 1.0, c=asked.HOLD_C, m=asked.HOLD_M)
    feb = solver.write(model, tmp_path / "hold")
    solver.run(feb, progress=SILENT)
    known = next(each for each in HOLDS if each.depth == 1.0)
    found = hold_of(solver.read(feb), 1.0)
    at = np.geomspace(0.1, 3000.0, 30)
    mine, theirs = (np.interp(at, each.spread, each.force) for each in (found, known))
    assert mine == pytest.approx(theirs, rel=2e-3)
