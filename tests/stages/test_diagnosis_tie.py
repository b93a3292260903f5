"""The working mesh beside the site's own run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError, SolveError
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.diagnosis.curves.curves import CurveBook
from limbcli.stages.diagnosis.mesh_doubt.mesh_ratio import own_curves, own_run
from limbcli.stages.run import run
from tests.stages import block_case as block

C = 0.008
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A case whose own mesh, tet4 of the usual block, was run at the start values."""
    root = tmp_path_factory.mktemp("tie")
    case = block.make_case(root / "case", root / "out", DEPTHS, DEPTHS**1.5, c=C)
    run(case, out=root / "out", solver="reference")
    return case, root / "out"


def _book(folder: Path, **counts) -> CurveBook:
    model = block.block_model("tet4", **counts)
    return CurveBook(model, [0.45, *DEPTHS], c=C, keep=folder, tolerance=1e-6, threads=1)


def test_run_is_scaled_to_the_reference_stiffness(ran):
    case, out = ran
    site = case.sites[0]
    own, twice = own_run(site, out, c=C), own_run(site, out, c=2 * C)
    assert own.element == "tet4"
    assert own.depth == pytest.approx(DEPTHS, abs=1e-6)
    assert twice.force == pytest.approx(2 * own.force, rel=1e-12)
    true = block.true_curve("tet4", DEPTHS, c=C, f_kappa=100.0, m=2.0)
    assert own.force == pytest.approx(true, rel=1e-3)


def test_run_with_other_start_values_ties_nothing(ran, tmp_path):
    case, _ = ran
    out = tmp_path / "out"
    other = block.make_case(tmp_path / "case", out, DEPTHS, DEPTHS**1.5, c=C, build=False)
    build_feb(other, out=out, options=TissueOptions(f_kappa=50.0))
    run(other, out=out, solver="reference")
    with pytest.raises(CaseError, match="other start values"):
        own_run(other.sites[0], out, c=C)
    assert case.sites[0].name == other.sites[0].name


def test_the_same_mesh_solved_again_is_the_same(tmp_path):
    book = _book(tmp_path)
    again = own_curves(block.block_model("tet4"), book, [5.0], size_ratio=1.0)[5.0]
    working = book.curves(5.0)
    book.close()
    at = np.searchsorted(working.depth, again.depth - 1e-6)
    assert len(at) == 4
    assert again.force == pytest.approx(working.force[at], rel=1e-3)


def test_a_penalty_in_proportion_to_the_edges_gives_meshes_the_same_contact(tmp_path):
    """The working mesh of twice the edges: with the same penalty its probe would sink in twice as far."""
    book = _book(tmp_path, counts=(6, 4, 2))
    fine = block.block_model("tet4", counts=(12, 8, 4))
    asked = book.model.contacts[0].penalty
    models = []
    for ratio in (0.5, 1.0):
        own = own_curves(fine, book, [2.0], size_ratio=ratio)[2.0]
        working = book.curves(2.0)
        models.append(own.force[-1] / np.interp(own.depth[-1], working.depth, working.force))
    book.close()
    assert asked == 80.0
    assert models[1] > 1.02 * models[0]


def test_a_solve_on_the_own_mesh_that_takes_too_much_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("limbcli.stages.diagnosis.mesh_doubt.mesh_ratio._LEAST_WORK", 1.0)
    book = _book(tmp_path)
    with pytest.raises(SolveError, match="several times the work"):
        own_curves(block.block_model("tet4"), book, [5.0], size_ratio=1.0)[5.0]
    book.close()
