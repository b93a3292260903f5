"""Every logged variable of every law, and of a turning body, against the records that FEBio 4.11 wrote.

tests/data/febio-logged.json holds FEBio's values (its 4.11.0, built from source, MKL Pardiso, full Newton,
dtol 1e-9) for the models of `logged_models`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.fem.record_fields import CELL_FIELDS
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT
from limbcli.solvers.reference import ReferenceSolver
from tests.solvers import logged_models

FEBIO = json.loads((Path(__file__).parents[1] / "data/febio-logged.json").read_text())


def logged(model: LimbModel, folder: Path) -> dict[str, tuple[Array, Array]]:
    """(times, values (n_times, n_fields)) of every record, by its kind."""
    ReferenceSolver(threads=1, tolerance=1e-11).run(write_feb(model, folder / "model.feb"), progress=SILENT)
    found = {each.kind: read_records(folder / each.file) for each in model.records}
    return {kind: (records.times, records.values[:, 0]) for kind, records in found.items()}


@pytest.mark.parametrize("law", list(logged_models.LAWS))
def test_every_logged_variable_of_a_law_is_febio_s(tmp_path: Path, law: str) -> None:
    model = logged_models.of_law(law)
    for kind, (times, values) in logged(model, tmp_path).items():
        mine = values[[int(np.argmin(abs(times - t))) for t in logged_models.TIMES]]
        febio = np.array(FEBIO[law][kind])
        names = next(each.fields for each in model.records if each.kind == kind)
        families = np.array([n if n in ("J", "sed") else n[0] for n in names])  # the tensor it belongs to
        size = np.array([abs(febio[:, families == each]).max() + 1e-9 for each in families])
        wrong = [
            n for n, off in zip(names, (abs(mine - febio) / size).max(axis=0), strict=True) if off > 1e-6
        ]
        assert not wrong, {n: (mine[:, names.index(n)], febio[:, names.index(n)]) for n in wrong}


def test_energy_with_prestrain_is_0_and_of_a_relaxing_law_between_its_base_s_and_the_first() -> None:
    column = CELL_FIELDS.index("sed")
    energy = {law: np.array(FEBIO[law]["element"])[:, column] for law in logged_models.LAWS}
    assert not energy["prestrain"].any()
    assert energy["viscoelastic"][1] > 1.1 * energy["ogden"][1]
    assert energy["ogden"][2] < energy["viscoelastic"][2] < energy["viscoelastic"][1]


def test_a_body_s_rotations_are_logged_as_febio_does(tmp_path: Path) -> None:
    """Beyond half a turn they go on, beyond a whole one they are about the opposite axis."""
    _, values = logged(logged_models.turning(), tmp_path)["rigid_body"]
    np.testing.assert_allclose(values, FEBIO["turning"]["rigid_body"], atol=1e-7)
    assert np.linalg.norm(values[:, 3:6], axis=1).max() > np.pi
