"""Bounded least squares beside scipy's trust-region reflective method, and with a guide."""

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from limbcli.errors import FitError, SolveError
from limbcli.inference.least_squares import least_squares_fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Residual

TIMES = np.linspace(0.0, 3.0, 25)


def decay(theta):
    """a exp(-b t), with its derivative."""
    a, b = theta
    shape = np.exp(-b * TIMES)
    return a * shape, np.column_stack([shape, -a * TIMES * shape])


def objective_for(data, calls=None):
    def objective(theta, derivative=True):
        if calls is not None:
            calls.append(theta.copy())
        values, jacobian = decay(theta)
        return Residual(data - values, -jacobian)

    return objective


def parameters(scale="ratio", low=(1e-3, 1e-3), high=(1e3, 1e3), start=(1.0, 1.0)):
    return [FitParameter(n, s, lo, hi, scale) for n, s, lo, hi in zip("ab", start, low, high, strict=True)]


@pytest.mark.parametrize("scale", ["ratio", "log"])
@pytest.mark.parametrize("start", [(1.0, 1.0), (50.0, 0.05), (0.02, 9.0)])
def test_exact_data_are_recovered_from_near_and_far(scale, start):
    data, _ = decay((7.0, 1.3))
    fit = least_squares_fit(objective_for(data), parameters(scale, start=start), max_iterations=200)
    np.testing.assert_allclose(fit.theta, (7.0, 1.3), rtol=1e-3)


@pytest.mark.parametrize(
    "box", [((1e-3, 1e-3), (1e3, 1e3)), ((1e-3, 1.6), (1e3, 1e3)), ((1e-3, 1e-3), (5.0, 1.1))]
)
def test_noisy_data_give_the_minimum_that_scipy_finds(box, rng):
    data = decay((7.0, 1.3))[0] + 0.3 * rng.standard_normal(len(TIMES))
    low, high = box
    start = np.clip((2.0, 1.0), low, high)
    fit = least_squares_fit(objective_for(data), parameters("ratio", low, high, start), tolerance=1e-7)
    twin = least_squares(
        lambda theta: data - decay(theta)[0], np.clip(start, np.array(low) * 1.01, np.array(high) * 0.99),
        bounds=box, xtol=1e-12, ftol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(fit.theta, twin.x, rtol=1e-4)
    assert fit.cost <= 2 * twin.cost * (1 + 1e-8)


def test_the_rosenbrock_valley_is_followed_to_its_end():
    def objective(theta, derivative=True):
        x, y = theta
        return Residual(np.array([10 * (y - x**2), 1 - x]), np.array([[-20 * x, 10.0], [-1.0, 0.0]]))

    start = [FitParameter("x", 0.1, 1e-3, 10.0), FitParameter("y", 3.0, 1e-3, 10.0)]
    fit = least_squares_fit(objective, start, tolerance=1e-6, max_iterations=200)
    np.testing.assert_allclose(fit.theta, (1.0, 1.0), rtol=1e-4)


def test_no_point_outside_the_bounds_is_ever_tried(rng):
    data = decay((7.0, 1.3))[0] + 0.3 * rng.standard_normal(len(TIMES))
    calls = []
    low, high = (1e-3, 1.5), (4.0, 3.0)
    least_squares_fit(objective_for(data, calls), parameters("ratio", low, high, (0.5, 2.0)))
    tried = np.array(calls)
    assert np.all(tried >= np.array(low))
    assert np.all(tried <= np.array(high))


def test_a_trial_without_answer_is_stepped_back_from():
    data, _ = decay((7.0, 1.3))

    def fragile(theta, derivative=True):
        if theta[0] > 8.0:
            raise SolveError("stopped", where="here", fix="none")
        return objective_for(data)(theta)

    fit = least_squares_fit(fragile, parameters(start=(0.5, 3.0)), max_iterations=200)
    np.testing.assert_allclose(fit.theta, (7.0, 1.3), rtol=1e-3)


def test_no_answer_at_the_start_is_an_error():
    def broken(theta, derivative=True):
        raise SolveError("stopped", where="here", fix="none")

    with pytest.raises(SolveError):
        least_squares_fit(broken, parameters())
    nan = Residual(np.full(3, np.nan), np.ones((3, 2)))
    with pytest.raises(FitError, match="not a number"):
        least_squares_fit(lambda theta, derivative=True: nan, parameters())


def test_a_fit_that_does_not_settle_says_so():
    data, _ = decay((7.0, 1.3))
    with pytest.raises(FitError, match="did not converge in 2 iterations") as caught:
        least_squares_fit(objective_for(data), parameters(start=(0.02, 9.0)), max_iterations=2)
    assert "force-depth.png" in str(caught.value), "fit.png is of a fit that ended"


def test_a_derivative_is_asked_for_only_at_accepted_points(rng):
    data = decay((7.0, 1.3))[0] + 0.3 * rng.standard_normal(len(TIMES))
    points = []

    def lazy(theta, derivative=True):
        points.append(derivative)
        values, jacobian = decay(theta)
        return Residual(data - values, -jacobian if derivative else None)

    fit = least_squares_fit(lazy, parameters(start=(0.02, 9.0)), max_iterations=200)
    assert sum(points) == len(fit.history)


def test_a_start_value_outside_its_bounds_is_an_error():
    with pytest.raises(FitError, match="outside"):
        FitParameter("m", start=0.5, low=1.0, high=100.0)


def test_nearly_collinear_parameters_do_not_stop_in_a_corner_of_their_bounds(rng):
    """Their steps cross two bounds at once; the least cost lies on one of them."""
    way = np.linspace(1.0, 2.0, 5)
    for _ in range(30):
        design = np.column_stack([way, way + 0.3 * rng.standard_normal(5)])
        data = design @ rng.uniform(-5.0, 8.0, 2) + 0.1 * rng.standard_normal(5)

        def objective(theta, derivative=True, design=design, data=data):
            return Residual(design @ theta - data, design)

        parameters = [FitParameter(name, 1.0, 0.5, 2.5) for name in ("a", "b")]
        fit = least_squares_fit(objective, parameters, tolerance=1e-8, must_settle=False)
        expected = 2.0 * lsq_linear(design, data, (0.5, 2.5)).cost
        assert fit.cost == pytest.approx(expected, rel=1e-4)
