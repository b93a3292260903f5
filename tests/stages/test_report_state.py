"""The deformed state is what the records say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.write import write_feb
from limbcli.model import (
    Block,
    Curve,
    Domain,
    LimbModel,
    LogRecord,
    Material,
    Mesh,
    Step,
    Support,
    Surface,
)
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.results import StageResult
from limbcli.stages.report_pages.simulated_state import read_deformed, read_residuals

GRADIENT = tuple(f"F{i}{j}" for i in "xyz" for j in "xyz")
_HEX_TO_TETS = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]


def box_model(*, with_gradient: bool = True, with_nodes: bool = True) -> LimbModel:
    """A block 60 x 30 x 20 mm of tissue below a square rigid plate."""
    x, y, z = np.linspace(-30, 30, 5), np.linspace(-15, 15, 4), np.linspace(-20, 0, 3)
    shape = (len(x), len(y), len(z))
    points = np.stack([axis.ravel() for axis in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    number = np.arange(len(points)).reshape(shape)
    i, j, k = (each.ravel() for each in np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"))
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = np.stack([number[i + a, j + b, k + c] for a, b, c in corners], axis=1)
    tets = np.concatenate([hexes[:, each] for each in _HEX_TO_TETS])
    plate = np.array([[-10.0, -5, 0.1], [10, -5, 0.1], [10, 5, 0.1], [-10, 5, 0.1]])
    quad = np.arange(4)[None, ::-1] + len(points)
    top = hexes[(k == shape[2] - 2)][:, 4:]
    skin = Surface("skin", {"tri3": np.concatenate([top[:, [0, 1, 2]], top[:, [0, 2, 3]]])})
    mesh = Mesh(
        np.concatenate([points, plate]),
        (Block("probe", "quad4", quad), Block("tissue", "tet4", tets)),
        {"fixed": np.flatnonzero(points[:, 2] == -20)},
        {"skin": skin, "probe_face": Surface("probe_face", {"quad4": quad})},
    )
    records = [LogRecord("rigid_body", ("x", "y", "z", "Fx", "Fy", "Fz"), "rigid_body.csv", "probe")]
    if with_nodes:
        records.append(LogRecord("node", ("ux", "uy", "uz"), "nodes.csv", np.arange(len(points))))
    if with_gradient:
        records.append(LogRecord("element", ("J", *GRADIENT), "elements.csv", np.arange(1, 1 + len(tets))))
    law = Material("ogden", {"c1": 0.005, "m1": 2.0, "c2": 0.005, "m2": -2.0, "kappa": 1.0})
    return LimbModel(
        mesh,
        {"tissue": law},
        (Domain("tissue", "tissue"),),
        bodies=(RigidBody("probe", (0.0, 0.0, 0.1), ("probe",)),),
        supports=(Support("fixed", ("x", "y", "z")),),
        drives=(Drive("probe", "z", "displacement", -4.1, "load"),),
        contacts=(Contact("skin", "probe_face"),),
        curves={"load": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(),),
        records=tuple(records),
    )


def squeezed(points: np.ndarray) -> np.ndarray:
    """Uniform: 20 % shorter in z, 5 % longer in x."""
    return np.column_stack([0.05 * points[:, 0], 0 * points[:, 1], 0.2 * (-20 - points[:, 2])])


def write_record(path: Path, blocks: Sequence[tuple[float, np.ndarray]], *, first_id: int = 1) -> None:
    lines = []
    for step, (time, rows) in enumerate(blocks, 1):
        lines += [f"*Step  = {step}", f"*Time  = {time}", "*Data  = x"]
        lines += [",".join([str(first_id + k), *(repr(float(v)) for v in row)]) for k, row in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")


def write_run(folder: Path, model: LimbModel) -> StageResult:
    """A run's files whose answer is known: half the squeeze at time 0.5, all of it at 1."""
    folder.mkdir(parents=True, exist_ok=True)
    write_feb(model, folder / "model.feb")
    tissue = model.mesh.block("tissue").cells
    u = squeezed(model.mesh.points[:-4])
    gradient = np.diag([1.05, 1.0, 0.8])
    names = {record.file for record in model.records}
    shares = (0.5, 1.0)
    write_record(
        folder / "rigid_body.csv", [(t, np.array([[0, 0, 0.1 - 4.1 * t, 0, 0, -9 * t]])) for t in shares]
    )
    if "nodes.csv" in names:
        write_record(folder / "nodes.csv", [(t, t * u) for t in shares])
    if "elements.csv" in names:
        rows = [np.r_[1.0, (np.eye(3) + t * (gradient - np.eye(3))).ravel()] for t in shares]
        blocks = [(t, np.tile(row, (len(tissue), 1))) for t, row in zip(shares, rows, strict=True)]
        write_record(folder / "elements.csv", blocks, first_id=2)
    return StageResult("run", "S1", folder, "p1")


def test_state_is_the_last_one_recorded(tmp_path):
    model = box_model()
    state = read_deformed(write_run(tmp_path, model))
    assert state is not None
    tissue = np.arange(len(model.mesh.points) - 4)
    np.testing.assert_allclose(state.displacement[tissue], squeezed(model.mesh.points[tissue]), atol=1e-12)
    assert np.isnan(state.displacement[-4:]).all()
    assert state.depth == pytest.approx(4.0)
    np.testing.assert_allclose(state.probe_shift, [0, 0, -4.1])


def test_shortening_is_the_smallest_stretch_of_each_tissue_cell(tmp_path):
    """Cells are counted over all blocks: the probe's facet comes first in this model."""
    state = read_deformed(write_run(tmp_path, box_model()))
    assert state is not None
    assert state.stretch is not None
    assert state.stretch.shape == (len(state.cells),)
    np.testing.assert_allclose(state.stretch, 0.8)


def test_without_gradients_there_is_no_shortening(tmp_path):
    state = read_deformed(write_run(tmp_path, box_model(with_gradient=False)))
    assert state is not None
    assert state.stretch is None


def test_without_displacements_the_error_says_what_to_do(tmp_path):
    with pytest.raises(SolveError, match="no displacements") as caught:
        read_deformed(write_run(tmp_path, box_model(with_nodes=False)))
    assert "run it again" in caught.value.fix


def test_a_stage_without_a_model_has_no_state(tmp_path):
    assert read_deformed(StageResult("fit", "S1", tmp_path, "p1")) is None


def test_residuals_come_from_the_log_or_from_recorded_events(tmp_path, golden):
    log = next((golden / "log-normal").glob("*.log"))
    (tmp_path / "model.log").write_bytes(log.read_bytes())
    found = read_residuals(StageResult("run", "S1", tmp_path, "p1"))
    assert found is not None
    assert found.ratio.size > 10
    assert np.all(np.diff(found.level) >= 0)
    assert found.ratio[-1] <= 1.0
    (tmp_path / "model.log").unlink()
    line = '{"kind": "newton", "step": 1, "residual": 0.5, "target": 0.1}\n'
    (tmp_path / "progress.jsonl").write_text('{"kind": "note"}\n' + line)
    found = read_residuals(StageResult("run", "S1", tmp_path, "p1"))
    assert found is not None
    np.testing.assert_allclose(found.ratio, [5.0])


@pytest.mark.parametrize("name", ["nodes.csv", "all"])
def test_records_that_end_too_early_are_told_even_at_the_end_of_a_step(tmp_path, name):
    result = write_run(tmp_path, box_model())
    for path in tmp_path.glob("*.csv" if name == "all" else name):
        text = path.read_text()
        path.write_text(text[: text.index("*Step  = 2")])
    with pytest.raises(SolveError, match="end at time 0.5" if name == "all" else "its times differ"):
        read_deformed(result)
