"""What a fit has solved is found by a later one, and only for the same model."""

from contextlib import closing

import numpy as np
import pytest

from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import ReferenceCurve
from limbcli.fitting.kept_solves import CheckSolver, KeptForces, KeptSolves
from limbcli.inference.prediction import Prediction
from limbcli.site_model.indentation_model import indentation_model, with_penalty, with_tissue
from limbcli.solvers.session import ReferenceSession
from tests.stages.block_case import block_model

SOLVED = KeptForces(
    np.array([1.0, 2.0]), Prediction(np.array([0.5, 1.5]), np.array([[0.1, 0.2], [0.3, 0.4]]))
)


def test_forces_are_found_bit_by_bit_and_only_for_the_same_model(tmp_path):
    kept = KeptSolves.of_site(tmp_path, "p1")
    model = with_tissue(block_model(), c=0.005, f_kappa=100.0, m=2.0)
    assert kept.forces(model) is None
    kept.keep_forces(model, SOLVED)
    again = KeptSolves.of_site(tmp_path, "p1")
    found = again.forces(with_tissue(block_model(), c=0.005, f_kappa=100.0, m=2.0))
    assert found is not None
    assert found.depths.tolist() == SOLVED.depths.tolist()
    assert found.prediction.values.tolist() == SOLVED.prediction.values.tolist()
    assert found.prediction.jacobian.tolist() == SOLVED.prediction.jacobian.tolist()
    assert again.forces(with_tissue(block_model(), c=0.005, f_kappa=100.0 + 1e-10, m=2.0)) is None
    assert again.checked(model) is None, "a check is solved to another tolerance"
    assert KeptSolves.of_site(tmp_path, "p2").forces(model) is None


def test_a_damaged_file_is_solved_again(tmp_path):
    kept, model = KeptSolves(tmp_path), block_model()
    kept.keep_forces(model, SOLVED)
    kept.keep_checked(model, SOLVED.prediction.values)
    assert kept.checked(model).tolist() == [0.5, 1.5]
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:100])
    assert kept.forces(model) is None
    assert kept.checked(model) is None


def test_without_a_folder_nothing_is_kept():
    kept, model = KeptSolves(), block_model()
    kept.keep_forces(model, SOLVED)
    assert kept.forces(model) is None


def test_a_curve_and_a_check_are_not_solved_twice(tmp_path, monkeypatch):
    model = indentation_model(
        block_model(counts=(4, 4, 2)), schedule([0.6, 1.2]), c=0.005, f_kappa=50.0, m=2.0
    )
    kept, theta = KeptSolves.of_site(tmp_path, "p1"), np.array([50.0, 3.0])
    with closing(ReferenceCurve(model, c=0.005, kept=kept)) as curve:
        first, depths = curve(theta, (0, 1)), curve.depths
        levels = curve.levels_at(theta)
    fitted = with_tissue(model, c=0.005, f_kappa=50.0, m=3.0)
    stiffer = with_penalty(fitted, 80.0)
    harder = CheckSolver(levels=levels, kept=kept).forces(stiffer)

    def refuse(*_args, **_options):
        raise AssertionError("solved again")

    monkeypatch.setattr(ReferenceSession, "solve", refuse)
    with closing(ReferenceCurve(model, c=0.005, kept=KeptSolves.of_site(tmp_path, "p1"))) as curve:
        again = curve(theta, (0, 1))
        assert (curve.n_solves, curve.n_kept) == (1, 1)
        assert curve.depths.tolist() == depths.tolist()
        assert again.values.tolist() == first.values.tolist()
        assert again.jacobian.tolist() == first.jacobian.tolist()
        assert list(curve.levels_at(theta).states) == list(levels.states)
        with pytest.raises(AssertionError, match="solved again"):
            curve(np.array([60.0, 3.0]), (0, 1))
    assert CheckSolver(kept=kept).forces(stiffer).tolist() == harder.tolist()
