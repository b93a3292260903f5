"""Record files of the reference solver: what is written, and how it is read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import punch

from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.model import LogRecord
from limbcli.progress import SILENT
from limbcli.solvers.base import Simulation
from limbcli.solvers.reference import ReferenceSolver


def run(feb: Path) -> Simulation:
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    return solver.read(feb)


def test_several_records_of_one_body_are_one_table(tmp_path: Path) -> None:
    records = (
        LogRecord("rigid_body", ("z", "thx"), "place.csv", "probe"),
        LogRecord("rigid_body", ("Fz", "z"), "force.csv", "probe"),
    )
    model = replace(punch(n=(2, 2, 2), depth=0.5), records=records)
    found = run(write_feb(model, tmp_path / "model.feb"))
    assert found.rigid["probe"].fields == ("z", "thx", "Fz")
    assert found.probe_depth()[-1] == pytest.approx(0.5)
    written = read_records(tmp_path / "force.csv").values[:, 0, 0]
    np.testing.assert_array_equal(found.probe_force(), -written)


def test_nothing_reacts_before_the_first_step(tmp_path: Path) -> None:
    """The probe stands a little inside the tissue there; FEBio's files hold zeros."""
    record = LogRecord("rigid_body", ("z", "Fx", "Fy", "Fz", "Mx", "My", "Mz"), "body.csv", "probe")
    model = replace(punch(n=(2, 2, 2), depth=0.5), records=(record,))
    body = run(write_feb(model, tmp_path / "model.feb")).rigid["probe"].values
    assert body[0, 0, 0] == pytest.approx(-0.05)
    assert not body[0, 0, 1:].any()
    assert abs(body[-1, 0, 3]) > 1e-3
