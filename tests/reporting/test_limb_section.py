"""The page's section on the whole limb: where its stiffness comes from, and the sites predicted without
themselves."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from limbcli.reporting.outcome import Failure, Outcome
from limbcli.reporting.sections.limb import limb
from limbcli.results import StageResult

ELEMENTS = {"identified": 30, "interpolated": 50, "assumed": 20}
LEFT_OUT = {"site": "p1", "c_kpa": 8.2, "predicted_kpa": 9.0, "predicted_95_kpa": [5.0, 16.0], "inside": True}


def page(**outcome):
    found = Outcome("limb", None, outcome.pop("status", "done"), "limbcli limb CASE", **outcome)
    return SimpleNamespace(outcomes=SimpleNamespace(maybe=lambda stage, _=None: found if outcome else None))


def result(folder: Path, **more) -> StageResult:
    stiffness = {"c_kpa": 8.5, "source": "field through sites p1, p2", "elements": ELEMENTS, **more}
    (folder / "limb.png").write_bytes(b"")
    return StageResult(
        "limb", "S1", folder, data={"stiffness": stiffness}, files={"picture": "limb.png"}, warnings=("cut",)
    )


def test_the_source_of_the_stiffness_and_the_sites_left_out_are_shown(tmp_path: Path):
    shown = limb(page(result=result(tmp_path, field={"held_out": {"sites": [LEFT_OUT]}})))
    assert shown is not None
    stiffness, left_out = shown.tables
    assert [cell.text for cell in stiffness.rows[0][1:]] == ["30 %", "50 %", "20 %"]
    assert "field through sites p1, p2" in stiffness.caption
    assert [cell.text for cell in left_out.rows[0]] == ["p1", "8.2", "9.0 (5.0 to 16.0)", "inside"]
    assert [each.source for each in shown.pictures] == [tmp_path / "limb.png"]
    assert (shown.mood, shown.warned) == ("warning", ("cut",))
    assert shown.look_for
    assert shown.bad


def test_one_stiffness_for_all_has_no_sites_to_leave_out(tmp_path: Path):
    shown = limb(page(result=result(tmp_path)))
    assert shown is not None
    assert len(shown.tables) == 1


def test_a_failed_run_has_its_place_and_no_run_none():
    failure = Failure("MeshError", "no mesh", "limb", "use fewer nodes")
    shown = limb(page(status="failed", failure=failure))
    assert shown is not None
    assert (shown.mood, shown.failure) == ("failed", failure)
    assert limb(page()) is None
