"""Record files of another material are told by their stresses."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import pytest

from limbcli.errors import SolveError
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.model import LimbModel
from limbcli.progress import SILENT
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.law_check import can_be_checked, check_first_step
from limbcli.solvers.record_tables import read_tables
from limbcli.solvers.reference import ReferenceSolver
from tests.stages.block_case import block_model


def with_c(model: LimbModel, factor: float) -> LimbModel:
    law = model.materials["tissue"]
    changed = {name: factor * law.parameters[name] for name in ("c1", "c2", "kappa")}
    return replace(model, materials={**model.materials, "tissue": law.with_parameters(**changed)})


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_a_run_bears_the_stress_of_its_law_and_of_no_other(tmp_path: Path, element: str) -> None:
    model = indentation_model(block_model(element), schedule([1.0, 2.0]), c=0.005, f_kappa=100.0, m=2.0)
    solver = ReferenceSolver(threads=1)
    feb = solver.write(model, tmp_path)
    solver.run(feb, progress=SILENT)
    elements = solver.read(feb).elements
    assert can_be_checked(elements)
    check_first_step(model, elements, tmp_path)
    check_first_step(with_c(model, 1.01), elements, tmp_path)
    with pytest.raises(SolveError, match="do not match the model's material"):
        check_first_step(with_c(model, 1.1), elements, tmp_path)


@pytest.mark.parametrize("name", ["punch-tet4", "punch-tet10-deep", "effect-base"])
def test_febio_s_own_results_pass(golden: Path, tmp_path: Path, name: str) -> None:
    for path in (golden / name).iterdir():
        content = path.read_bytes()
        packed = path.suffix == ".gz"
        (tmp_path / (path.stem if packed else path.name)).write_bytes(
            gzip.decompress(content) if packed else content
        )
    feb = tmp_path / "model.feb"
    outline = read_outline(feb)
    only = replace(outline, records=tuple(each for each in outline.records if each.kind == "element"))
    elements = read_tables(only, tmp_path).elements
    check_first_step(read_feb(feb), elements, tmp_path)
    with pytest.raises(SolveError, match="do not match"):
        check_first_step(with_c(read_feb(feb), 0.9), elements, tmp_path)
