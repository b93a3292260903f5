"""Results of stages that may be missing or damaged."""

from __future__ import annotations

from pathlib import Path

from limbcli.results import data_if_there, open_stage


def test_a_result_that_is_missing_or_was_changed_has_no_data(tmp_path: Path) -> None:
    assert data_if_there(tmp_path, "mesh", site="p1") == {}
    with open_stage(tmp_path, "mesh", subject="x", site="p1") as writer:
        writer.data["n_cells"] = 12
    assert data_if_there(tmp_path, "mesh", site="p1")["n_cells"] == 12
    (path,) = tmp_path.rglob("mesh.json")
    path.write_text(path.read_text(encoding="utf-8").replace("12", "13"), encoding="utf-8")
    assert data_if_there(tmp_path, "mesh", site="p1") == {}
