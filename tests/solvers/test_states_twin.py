"""A stretched state, as it is written for FEBio, against what FEBio 4.11 made of that very file.

tests/data/febio-states.json holds FEBio's forces (its 4.11.0, built from source, MKL Pardiso, one thread).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from limbcli.feb.settings import schedule
from limbcli.feb.write import write_feb
from limbcli.progress import SILENT
from limbcli.site_model.indentation_model import indentation_model
from limbcli.site_model.prestretch import in_state
from limbcli.solvers.reference import ReferenceSolver
from tests.stages.block_case import block_model

FEBIO = json.loads((Path(__file__).parents[1] / "data/febio-states.json").read_text())
STRETCHES = {"shortened": (0.8, 1.05), "stretched": (1.15, 0.95)}  # along and around the limb
DEPTHS = [0.5, 1.5, 3.0]  # mm, the probe's


def write_state(folder: Path, element: str, state: str) -> Path:
    """The block in one of its states, as a model file."""
    model = indentation_model(block_model(element), schedule([1.0, 2.0]), c=0.006, f_kappa=50.0, m=6.0)
    along, around = STRETCHES[state]
    return write_feb(in_state(model, DEPTHS, along=along, around=around), folder / "model.feb")


@pytest.mark.slow
@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize("state", list(STRETCHES))
def test_a_state_has_the_forces_that_febio_gives_it(tmp_path: Path, element: str, state: str) -> None:
    feb = write_state(tmp_path, element, state)
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    forces = solver.read(feb).probe_force()[-len(DEPTHS) :]
    assert forces == pytest.approx(np.array(FEBIO[element][state]), abs=2e-4 * forces.max())
