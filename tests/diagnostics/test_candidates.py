"""Where the fits of candidates begin: at the point of the grid that says most."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.candidates import whitened_trials
from limbcli.diagnostics.selection.refits import Refits
from limbcli.effects import effect
from limbcli.effects.reading import read
from limbcli.measurement.elastography import SweMap
from limbcli.progress import SILENT
from limbcli.stages.diagnosis.data.site_data import site_data
from limbcli.stages.diagnosis.data.windows import Windows
from limbcli.stages.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.stages.diagnosis.forward_model.surrogate import SiteCurves
from tests.diagnostics import reduced, toy

REGION = Windows(across=10, down=6, whole_is_known=True)


class Placed(toy.Toy):
    """`place` lies at some point of its grid."""

    def directions(self, fitted, name):
        found = super().directions(fitted, name)
        if name != "place":
            return found
        return [Direction(d.columns, d.signs, d.point, d.names, {"x": float(d.point[3:])}) for d in found]


def test_what_a_point_of_a_grid_begins_with_goes_with_its_trial(rng):
    data = Placed(toy.make(rng).y)
    baseline = BaselineFit(data, data.fit((), {}), 7, 200)
    trials = whitened_trials(data, baseline.base, {"place": None}, baseline.whiten, {}, SILENT)
    assert [each.at for each in trials[0].directions] == [{"x": 0.25}, {"x": 0.5}, {"x": 0.75}]


def with_a_ball(rng, x: float, depth: float) -> SiteForwardModel:
    """Maps of a reduced model with a stiff ball of 5 mm, another block than the one that is fitted."""
    theta = {"inclusion_x_mm": x, "inclusion_depth_mm": depth, "inclusion_radius_mm": 5.0}
    ball = ((effect("inclusion"), {"log_inclusion_ratio": 1.2, **theta}),)
    true = reduced.ReducedBook(
        reduced.block_model(9, 6, 7), np.linspace(0, 8, 7), spread=1.03, windows=REGION
    )
    levels = reduced.measured(rng, ball, simulations=true, n_levels=5)
    curves, reading, protocol = reduced.truth(ball, None, simulations=true, n_levels=5)
    lateral, below = (each.ravel() for each in np.meshgrid(np.arange(-19.5, 20.0), np.arange(2.5, 25.0)))
    parts = np.exp(read(curves, protocol, reading).log_speed[:, 1:])[:, REGION.part_of(lateral, below)]
    noise = 1 + 0.03 * rng.standard_normal((5, 1)) + 0.1 * rng.standard_normal(parts.shape)
    maps = [SweMap(lateral, below, each) for each in parts * noise]
    simulations = reduced.ReducedBook(reduced.block_model(8, 5, 6), np.linspace(0, 8, 6), windows=REGION)
    site = site_data("p1", levels, reduced.NOISE, windows=REGION, maps=maps)
    return SiteForwardModel([SiteCurves(site, simulations, {"inclusion": effect("inclusion")})])


@pytest.mark.slow
@pytest.mark.parametrize(("x", "depth"), [(-14.0, 19.0)])
def test_a_ball_beside_the_middle_is_found_where_it_is(rng, x, depth):
    """From the middle of the window least squares end in a large soft ball on the other side."""
    forward_model, not_evaluated = with_a_ball(rng, x, depth), {}
    facts = {each.name: each for each in forward_model.candidates}
    baseline = BaselineFit(forward_model, forward_model.fit((), {}), 7, 200)
    (trial,) = whitened_trials(forward_model, baseline.base, facts, baseline.whiten, not_evaluated, SILENT)
    refits = Refits(baseline, {"inclusion": trial}, facts, not_evaluated, {})
    found = refits.of(("inclusion",))
    assert found is not None
    assert found.state.chi2 < 0.2 * baseline.state.chi2
    values = found.fitted.values
    assert (values["inclusion_x_mm"], values["inclusion_depth_mm"]) == pytest.approx((x, depth), abs=2.0)
    assert values["log_inclusion_ratio"] == pytest.approx(1.2, abs=0.4)  # of so small a ball, with its edge
