"""The rows of a record: when they are written, and their step numbers, against those of FEBio 4.11.

tests/data/febio-output.json holds [step, time, values ...] that FEBio wrote for `logged_models`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.model import Step
from limbcli.progress import SILENT
from limbcli.solvers.reference import ReferenceSolver
from tests.solvers import logged_models

FEBIO = json.loads((Path(__file__).parents[1] / "data/febio-output.json").read_text())


@pytest.mark.parametrize("case", list(FEBIO))
def test_rows_are_those_that_febio_writes(tmp_path: Path, case: str) -> None:
    law, name = case.split(": ")
    feb = write_feb(logged_models.of_output(name, law=law), tmp_path / "model.feb")
    ReferenceSolver(threads=1, tolerance=1e-10).run(feb, progress=SILENT)
    found = read_records(tmp_path / "nodes.csv")
    table = np.column_stack([found.steps, found.times, found.values.reshape(len(found.steps), -1)])
    np.testing.assert_allclose(table, FEBIO[case], rtol=1e-6, atol=1e-8)


def test_only_must_points_are_written_and_that_is_said(tmp_path: Path) -> None:
    model = logged_models.of_output("must-points")
    silent = replace(model.steps[0], control={})
    feb = write_feb(replace(model, steps=(silent,)), tmp_path / "model.feb")
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    found = solver.read(feb)
    assert found.times.tolist() == [0.0, 0.35, 0.7, 1.0]
    assert any("only must-points" in each for each in found.warnings)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<solver", "<!-- <solver", "<solver> is missing"),
        ("<output_level>OUTPUT_FINAL", "<output_level>SOMETIMES", "not an output level"),
        ("<output_level>OUTPUT_FINAL</output_level>", "<output_stride>0</output_stride>", "not positive"),
        (">0.3</dtmax>", ">0</dtmax><dtforce>1</dtforce>", "<dtforce>"),
    ],
)
def test_what_febio_refuses_in_control_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    feb = write_feb(logged_models.of_output("final"), tmp_path / "model.feb")
    text = feb.read_text().replace(old, new)
    feb.write_text(text.replace("</solver>", "</solver> -->") if "<!--" in new else text)
    with pytest.raises(CaseError, match=words):
        read_feb(feb)


@pytest.mark.parametrize(("level", "words"), [("OUTPUT_NEVER", "empty"), ("2", "has not converged")])
def test_records_that_febio_would_not_write_are_refused(tmp_path: Path, level: str, words: str) -> None:
    model = logged_models.of_output("final")
    step: Step = replace(model.steps[0], control={"output_level": level})
    feb = write_feb(replace(model, steps=(step,)), tmp_path / "model.feb")
    assert read_outline(feb).output_levels
    with pytest.raises(CaseError, match=words):
        ReferenceSolver(threads=1).run(feb, progress=SILENT)
