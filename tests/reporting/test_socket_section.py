"""The page's section on the socket: its table with intervals, its warnings, and a failed run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.reporting.outcome import Failure, Outcome
from limbcli.reporting.sections.limb import socket
from limbcli.results import StageResult

ROW = {
    "load_n": 400.0, "patch": "tibial_end", "area_mm2": 900.0, "contact_area_mm2": 850.0, "mean_kpa": 31.0,
    "p95_kpa": 55.0, "peak_kpa": 70.0, "mean_shear_kpa": 2.0, "peak_shear_kpa": 9.0,
}  # fmt: skip
LIMITS = {"load_n": 400.0, "patch": "tibial_end", "quantity": "mean_kpa", "low": 28.0, "high": 34.5}


def page(**outcome):
    found = Outcome("socket", None, outcome.pop("status", "done"), "limbcli socket CASE", **outcome)
    return SimpleNamespace(outcomes=SimpleNamespace(maybe=lambda stage, _=None: found if outcome else None))


def result(**data) -> StageResult:
    shown = {"patches": [ROW], "pressed": "liner", **data}
    return StageResult("socket", "S1", Path("out/socket"), data=shown, warnings=("soft",))


def test_a_row_has_its_limits():
    shown = socket(page(result=result(intervals={"patches": [LIMITS]})))
    assert shown is not None
    assert shown.tables[0].caption == "Pressure and shear on the liner, kPa (95 % over the limb's draws)"
    (row,) = shown.tables[0].rows
    assert [cell.text for cell in row[:3]] == ["400 N: tibial end", "8.5 cm²", "31.0 (28.0 to 34.5)"]
    assert row[3].text == "55.0"
    assert (shown.mood, shown.warned) == ("warning", ("soft",))
    assert shown.look_for
    assert shown.bad


def test_the_last_load_can_be_turned(tmp_path: Path):
    (tmp_path / "p.png").write_bytes(b"")
    corners = np.eye(3)
    values = {
        "displacement": 0 * corners,
        "triangles": np.array([[0, 1, 2]]),
        "pressure_kpa": np.array([0, 1, 4]),
    }
    np.savez(tmp_path / "skin.npz", points=corners, **values)
    files = {"picture_donned": "p.png", "skin": "skin.npz"}
    found = StageResult("socket", "S1", tmp_path, data={"patches": [ROW], "pressed": "skin"}, files=files)
    shown = socket(page(result=found))
    assert shown is not None
    still, turned = shown.pictures
    assert (still.scene, turned.source) == (None, tmp_path / "p.png")
    assert turned.scene is not None
    assert turned.scene["field_kpa"] == pytest.approx(4.0, rel=0.02)


def test_without_the_stage_there_is_no_section():
    assert socket(page()) is None


def test_a_failed_run_has_its_place():
    failure = Failure("SolveError", "donning has no equilibrium", "step 3", "use more steps")
    shown = socket(page(status="failed", failure=failure))
    assert shown is not None
    assert shown.title == "How does the socket press on the limb?"
    assert (shown.mood, shown.failure) == ("failed", failure)
