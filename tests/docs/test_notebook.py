"""The notebook of the first hour, cell by cell as a reader runs it, and what it shows."""

from __future__ import annotations

from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="needs nbclient, of the extra dev")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient, of the extra dev")
pytest.importorskip("ipykernel", reason="needs ipykernel, of the extra dev")

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "first-hour.ipynb"


def test_the_notebook_is_stored_without_outputs():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not each.outputs for each in notebook.cells if each.cell_type == "code")


@pytest.mark.slow
def test_every_cell_runs_and_results_show_themselves(tmp_path: Path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=500, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    shown = [
        output.data.get("text/html", "")
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type in ("display_data", "execute_result")
    ]
    assert any("left limb" in each and "<th>site</th>" in each for each in shown)  # the case
    assert any("data:image/png;base64" in each for each in shown)  # a result's picture
    assert any("<table>" in each and "f_kappa" in each for each in shown)  # the fit
    assert any(each.startswith("<div>fit p1") for each in shown)  # progress, where it ended
    printed = "".join(
        output.text for cell in notebook.cells for output in cell.get("outputs", []) if "text" in output
    )
    assert "[Ranger 2023]" in printed
    assert (tmp_path / "first-hour" / "results" / "report" / "report.html").is_file()
