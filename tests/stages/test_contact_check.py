"""What a harder contact changes: of the model as it was fitted, led by the fit's own levels."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import FIBRE_BAND, LawCurve
from limbcli.fitting.laws import LAWS
from limbcli.fitting.model_checks import write_contact_check
from limbcli.progress import SILENT, Progress
from limbcli.site_model.indentation_model import TISSUE, indentation_model, softer_jumps, with_penalty
from limbcli.solvers.session import ReferenceSession
from tests.stages import block_case as block

C, SHAPE = 0.006, np.array([3.0, 0.9, 1.0])  # MPa; m, fibre_shear, fibre_tension


class Counts:
    """Newton iterations; with `stop`, the solver gets no further than so many levels."""

    def __init__(self):
        self.n, self.stop = 0, 10**6

    def __call__(self, kind, facts):
        if kind == "newton":
            self.n += 1
            if facts["step"] > self.stop:
                raise SolveError("as far as it goes", where="level", fix="none")


def fibred(progress: Progress = SILENT) -> tuple[LawCurve, object]:
    model = indentation_model(block.block_model(), schedule([0.6, 1.2, 2.0, 3.0]), c=C, f_kappa=100.0, m=2.0)
    law = LAWS["fibres"]
    curve = LawCurve(model, law, c=C, density_kg_per_m3=1000.0, speeds=False, progress=progress)
    return curve, model.with_material(TISSUE, law.material(C, SHAPE))


@pytest.mark.slow
def test_a_harder_contact_is_compared_with_the_law_that_was_fitted():
    """The fit's fibres come in over a wider band than the law's own: both sides have to have it."""
    curve, model = fibred()
    curve(SHAPE)
    found = curve.with_penalty(SHAPE, 80.0)
    curve.close()
    forces = []
    for each in (softer_jumps(model, FIBRE_BAND), model):
        with ReferenceSession(with_penalty(each, 80.0), threads=1) as session:
            forces.append(session.solve().must_points.forces)
    np.testing.assert_allclose(found, forces[0], rtol=1e-3)
    assert np.abs(found / forces[1] - 1.0).max() > 2e-3  # what the band alone would have added


@pytest.mark.slow
def test_levels_that_a_harder_contact_does_not_reach_soon_are_left_out_and_it_is_said():
    counts = Counts()
    curve, _ = fibred(Progress(counts))
    forces = curve(SHAPE).values
    counts.stop = 2
    writer = SimpleNamespace(data={}, summary=[], warnings=[])
    write_contact_check(
        20.0, forces, curve.depths, lambda penalty: curve.with_penalty(SHAPE, penalty), writer, site="p1"
    )
    counts.stop = 0
    with pytest.raises(SolveError):
        curve.with_penalty(SHAPE, 80.0)
    curve.close()
    found = writer.data["contact_check"]["p1"]
    assert len(found["depths_mm"]) == len(found["force_change_fraction"]) == 2
    assert writer.summary[0].endswith("(evaluated down to 1.2 mm)")
