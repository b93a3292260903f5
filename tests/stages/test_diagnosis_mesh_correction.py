"""The working mesh beside the site's own run."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.diagnosis import written_model as written
from limbcli.diagnosis.curves.curve_plan import Solving
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.mesh_error.mesh_correction import (
    MeshCorrection,
    corrected,
    left_error,
    own_curves,
    own_run,
)
from limbcli.diagnosis.mesh_error.numerical_checks import Notes
from limbcli.effects.curves import Curves
from limbcli.errors import CaseError
from limbcli.model.npz_file import save_model
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.site_model.site_layers import LayerLaw, with_layer_laws
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import BudgetSpent
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.run import run
from tests.stages import block_case as block
from tests.stages.test_site_layers import layered_block

C = 0.008
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A case whose own mesh, tet4 of the usual block, was run at the start values."""
    root = tmp_path_factory.mktemp("tie")
    case = block.make_case(root / "case", root / "out", DEPTHS, DEPTHS**1.5, c=C)
    run(case, out=root / "out", solver="reference")
    return case, root / "out"


def _simulations(folder: Path, **counts) -> SiteSimulations:
    model = block.block_model("tet4", **counts)
    return SiteSimulations(
        model, [0.45, *DEPTHS], c=C, keep=folder, solving=Solving(tolerance=1e-6, threads=1)
    )


def test_run_is_scaled_to_the_reference_stiffness(ran):
    case, out = ran
    site = case.sites[0]
    (element, own), (_, twice) = own_run(site, out, c=C), own_run(site, out, c=2 * C)
    assert element == "tet4"
    assert own.depth == pytest.approx(np.r_[0.0, DEPTHS], abs=1e-6)
    assert twice.force == pytest.approx(2 * own.force, rel=1e-12)
    true = block.true_curve("tet4", DEPTHS, c=C, f_kappa=100.0, m=2.0)
    assert own.force[1:] == pytest.approx(true, rel=1e-3)


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
    simulations = _simulations(tmp_path)
    again = own_curves(block.block_model("tet4"), simulations, [5.0], size_ratio=1.0)[5.0]
    working = simulations.curves(5.0)
    simulations.close()
    at = np.searchsorted(working.depth, again.depth - 1e-6)
    assert len(at) == 5
    assert again.depth[-1] == pytest.approx(DEPTHS[-1])  # nothing is extrapolated beyond it
    assert again.force == pytest.approx(working.force[at], rel=1e-3)


@pytest.mark.slow
def test_a_penalty_in_proportion_to_the_edges_gives_meshes_the_same_contact(tmp_path):
    """The working mesh of twice the edges: with the same penalty its probe would sink in twice as far."""
    simulations = _simulations(tmp_path, counts=(6, 4, 2))
    fine = block.block_model("tet4", counts=(12, 8, 4))
    requested = simulations.model.contacts[0].penalty
    models = []
    for ratio in (0.5, 1.0):
        own = own_curves(fine, simulations, [2.0], size_ratio=ratio)[2.0]
        working = simulations.curves(2.0)
        models.append(own.force[-1] / np.interp(own.depth[-1], working.depth, working.force))
    simulations.close()
    assert requested == 80.0
    assert models[1] > 1.02 * models[0]


def test_a_solve_on_the_own_mesh_that_takes_too_much_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("limbcli.diagnosis.mesh_error.mesh_correction._LEAST_WORK", 1.0)
    simulations = _simulations(tmp_path)
    with pytest.raises(BudgetSpent):
        own_curves(block.block_model("tet4"), simulations, [5.0], size_ratio=1.0)[5.0]
    simulations.close()


def test_a_layer_beside_the_tissue_is_no_error_of_a_mesh(ran, tmp_path):
    """Fat of 1.5 kPa had made the force 0.41 of the working mesh's, and the mesh wrong by as much."""
    case, out = ran
    site, layered = case.sites[0], tmp_path / "out"
    shutil.copytree(out, layered)
    with open_stage(layered, "mesh", subject=case.subject, site="p1") as writer:
        writer.data.update(element="tet10", size_under_probe_mm=5.0, layers={"fat_mm": 5.3})
        soft = with_layer_laws(layered_block(), {"fat": LayerLaw()})
        save_model(soft, writer.file("model", "model.npz"))
    notes, simulations = Notes(), _simulations(tmp_path)
    checks = SimpleNamespace(
        site=site, depth=DEPTHS, simulations=simulations, out=layered, size=5.0, notes=notes, progress=SILENT
    )
    correction = corrected(checks, [4.0], freed={}, held={})
    simulations.close()
    assert not correction.logs[..., 0].any()
    assert correction.mesh_error.max() < 0.2
    assert "has layers (fat) as well as the tissue" in notes.warnings[0]
    with pytest.raises(CaseError, match="has fat as well as the tissue"):
        own_run(site, layered, c=C)
    mine, reported = SimpleNamespace(site=site), SimpleNamespace(warnings=[])
    written.write_diagnosed(None, None, mine, reported, out=layered, number=0)
    assert "no .feb was written: the site's mesh has fat" in reported.warnings[0]


def _corrected(
    curves: dict[float, Curves], depth: np.ndarray, size: float = 5.0, **changed
) -> MeshCorrection:
    checks = SimpleNamespace(simulations=SimpleNamespace(curves=curves.__getitem__), depth=depth, size=size)
    return corrected(checks, list(curves), solves=False, **{"freed": {}, "held": {}, **changed})


def _curves(force: list[float], log_speed: list[float]) -> Curves:
    return Curves(np.arange(len(force)) * 1.0, np.array(force), np.array(log_speed)[:, None], np.zeros(1))


def test_the_limb_is_half_way_from_a_cut_that_is_held_to_one_that_is_free():
    """Of ln force and ln speeds; a part that the free model does not show moves as at the next depths."""
    held, freed = _curves([0.0, 2.0, 5.0], [0.1, 0.2, 0.3]), _curves([0.0, 1.0, 3.2], [0.0, np.nan, 0.5])
    depth = np.array([0.0, 1.5, 2.0])
    assert not _corrected({4.0: held}, depth).logs.any()
    found = _corrected({4.0: held}, depth, freed={4.0: freed})
    assert held.force * np.exp(found.logs[0, :, 0]) == pytest.approx(np.sqrt(held.force * freed.force))
    assert found.logs[0, :, 1] == pytest.approx([-0.05, 0.025, 0.1])


def test_the_limb_is_half_way_from_a_far_side_that_is_free_to_one_that_is_held():
    """Beside what freeing the cut changes."""
    plain, freed = _curves([0.0, 2.0, 5.0], [0.1, 0.2, 0.3]), _curves([0.0, 1.0, 3.2], [0.0, 0.1, 0.5])
    held = _curves([0.0, 2.2, 6.0], [0.1, 0.3, 0.2])
    depth = np.array([0.0, 1.5, 2.0])
    alone = _corrected({4.0: plain}, depth, held={4.0: held})
    assert plain.force * np.exp(alone.logs[0, :, 0]) == pytest.approx(np.sqrt(plain.force * held.force))
    both = _corrected({4.0: plain}, depth, freed={4.0: freed}, held={4.0: held})
    cut = _corrected({4.0: plain}, depth, freed={4.0: freed})
    assert both.logs == pytest.approx(alone.logs + cut.logs)


def test_the_deepest_depths_of_the_own_mesh_are_attempted_but_not_required(tmp_path, monkeypatch):
    given, solve = [], ReferenceSession.solve

    def noted(self, *args, **options):
        given.append((options["stop"].required, options["stop"].full_effort))
        return solve(self, *args, **options)

    simulations = _simulations(tmp_path)
    simulations.curves(5.0)
    monkeypatch.setattr(ReferenceSession, "solve", noted)
    own_curves(block.block_model("tet4"), simulations, [5.0], size_ratio=2.0)
    simulations.close()
    assert given == [(3, 4)]  # of 0.9, 1.8, 2.7, 3.6 mm: 0.6 of the depth, and all of it


def test_an_error_of_quadratic_elements_goes_as_the_square_of_their_edge():
    """Of forces that are too large by k h^2: half as much again as the finer mesh keeps."""
    for size, h in ((5.0, 2.5), (6.0, 2.0)):
        kept = h**2 / (size**2 - h**2)
        assert left_error(h, size) == pytest.approx(1.5 * kept)
    curves = {4.0: _curves([0.0, 1.0], [0.0, 0.0])}
    usual = [_corrected(curves, np.zeros(2), size).mesh_error for size in (2.5, 5.0)]
    assert usual[0] == pytest.approx(0.03)
    assert usual[1] == pytest.approx(4 * usual[0])


def _correction(several: list[float], force: list[float], speed: list[float]) -> MeshCorrection:
    """Of two depths and one part; the same at both depths."""
    return MeshCorrection(
        m=np.array(several), logs=np.repeat(np.array([force, speed]).T[:, None], 2, axis=1),
        thickness_ratio=1.0, mesh_error=np.zeros(1), speed_error=np.zeros(1),
    )  # fmt: skip


def test_tie_is_what_was_found_at_its_m_and_even_in_between():
    correction = _correction([4.0, 8.0], [-0.02, -0.06], [0.01, 0.05])
    assert correction.at(4.0) == pytest.approx(np.array([[-0.02, 0.01]] * 2), abs=1e-15)
    assert correction.at(8.0) == pytest.approx(np.array([[-0.06, 0.05]] * 2), abs=1e-15)
    middle = (0.25 * (np.hypot(8.0, 4.0) + np.hypot(8.0, 8.0)) ** 2 - 8.0**2) ** 0.5  # half-way in `bend`
    assert correction.at(float(middle)) == pytest.approx(np.array([[-0.04, 0.03]] * 2), abs=1e-12)


@pytest.mark.parametrize(("m", "further", "end"), [(2.5, 1.5, 4.0), (15.0, 18.0, 8.0)])
def test_tie_is_hardly_extended_beyond_its_m_and_has_no_corner_there(m, further, end):
    correction = _correction([4.0, 8.0], [-0.02, -0.06], [0.01, 0.05])
    assert np.array_equal(correction.at(m), correction.at(further))
    assert np.abs(correction.at(m) - correction.at(end)).max() <= 0.1 * 0.04 + 1e-12
    slopes = [(correction.at(end + h) - correction.at(end + h - 1e-4)) / 1e-4 for h in (0.0, 1e-4)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-2)
    assert np.array_equal(
        _correction([4.0], [-0.02], [0.01]).at(m), _correction([4.0], [-0.02], [0.01]).at(4.0)
    )


def test_several_m_on_the_own_mesh_are_each_its_own(tmp_path):
    simulations = _simulations(tmp_path)
    found = own_curves(block.block_model("tet4"), simulations, [5.0, 3.0], size_ratio=1.0)
    for m, own in found.items():
        working = simulations.curves(m)
        at = np.searchsorted(working.depth, own.depth - 1e-6)
        assert own.force == pytest.approx(working.force[at], rel=1e-3)
    simulations.close()
    assert list(found) == [5.0, 3.0]
    assert found[5.0].force[-1] > found[3.0].force[-1]
