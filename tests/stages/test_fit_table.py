"""Standard errors of fit.json, against the scatter of repeated fits on the cheap limb."""

from pathlib import Path

import numpy as np
import pytest

from limbcli.inference.interval import Stiffness
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.two_step_fit import ForceDepth, two_step
from limbcli.stages.fitting.table import Identified, total_covariance
from tests.loading import module_at

C, KNOTS = 0.008, np.linspace(1.0, 11.0, 11)


@pytest.mark.parametrize("larger", [1.0, 4.0])
def test_a_standard_error_is_the_scatter_of_fits_also_where_noise_is_larger_than_stated(larger):
    """Of m alone, which these data tell; 14 fits tell a deviation to a fifth."""
    limb = module_at(Path(__file__).parents[1] / "inference" / "simulated.py")
    rng, found, stated = np.random.default_rng(7), [], []
    memory = SolvedPoints(limb.curve(KNOTS, C, "tet4"))
    for _ in range(14):
        force = limb.force(KNOTS, C, 50.0, 5.0, "tet4") + larger * 0.1 * rng.standard_normal(len(KNOTS))
        data = ForceDepth(force, KNOTS, 0.1, 0.0)
        steps = two_step(memory, KNOTS, data, guided=False)
        whole = Identified(memory, KNOTS, data, Stiffness(C, 0.0), "", steps[0].theta, steps, None, 0.0)
        found.append(np.log(steps[-1].theta[1]))
        stated.append(np.sqrt(total_covariance(whole, steps[-1])[2, 2]))
    assert np.median(stated) == pytest.approx(np.std(found, ddof=1), rel=0.5)
