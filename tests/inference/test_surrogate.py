"""The surrogate built from solved points."""

import numpy as np

from limbcli.inference.surrogate import Node, Surrogate

KNOTS = np.array([2.0, 5.0, 8.0])


def node(simulated, theta, graded=True):
    theta = np.array(theta)
    answer = simulated.curve(KNOTS, 0.008)(theta, (0, 1))
    slope = answer.jacobian * theta / answer.values[:, None]
    return Node(np.log(theta), np.log(answer.values), slope if graded else None)


THETAS = ((100.0, 2.0), (30.0, 3.0), (10.0, 5.0), (5.0, 2.0), (300.0, 4.0))


def test_values_and_derivatives_at_the_nodes_are_reproduced(simulated):
    nodes = [node(simulated, theta) for theta in THETAS]
    surrogate = Surrogate(nodes)
    for each in nodes:
        y, slope = surrogate(each.x)
        np.testing.assert_allclose(y, each.y, atol=1e-5)
        np.testing.assert_allclose(slope, each.slope, atol=1e-4)
        assert surrogate.deviation(each.x).max() < 1e-4


def test_between_the_nodes_it_predicts_within_its_own_deviation(simulated, rng):
    surrogate = Surrogate([node(simulated, theta) for theta in THETAS])
    errors = []
    for _ in range(40):
        theta = np.exp([rng.uniform(np.log(5), np.log(300)), rng.uniform(np.log(2), np.log(5))])
        y, _ = surrogate(np.log(theta))
        errors.append(np.abs(y - node(simulated, theta).y).max() / surrogate.deviation(np.log(theta)).max())
    assert np.quantile(errors, 0.9) < 3.0


def test_its_derivative_is_that_of_differences(simulated):
    surrogate = Surrogate([node(simulated, theta) for theta in THETAS])
    x, step = np.log(np.array([17.0, 2.7])), 1e-5
    for k in range(2):
        move = step * np.eye(2)[k]
        rise = (surrogate(x + move)[0] - surrogate(x - move)[0]) / (2 * step)
        np.testing.assert_allclose(surrogate(x)[1][:, k], rise, rtol=1e-4, atol=1e-7)


def test_nodes_without_derivatives_are_used_too(simulated):
    graded = [node(simulated, theta) for theta in THETAS[:3]]
    x = np.log(np.array(THETAS[3]))
    before = abs(Surrogate(graded)(x)[0] - node(simulated, THETAS[3]).y).max()
    after = abs(
        Surrogate([*graded, node(simulated, THETAS[3], graded=False)])(x)[0] - node(simulated, THETAS[3]).y
    )
    assert after.max() < 1e-5 < before


def test_doubt_grows_away_from_the_nodes(simulated):
    surrogate = Surrogate([node(simulated, theta) for theta in THETAS])
    near, far = np.log(np.array([90.0, 2.1])), np.log(np.array([0.05, 20.0]))
    assert surrogate.deviation(far).max() > 10 * surrogate.deviation(near).max()


def test_a_coordinate_is_chosen_in_which_the_response_is_even():
    """Rate: forces that grow as stretch^m are told far beyond the solved m, and powers of theta, too."""
    stretch = np.array([1.05, 1.1, 1.2])

    def exponential(m):
        return Node(np.log([m]), m * np.log(stretch), m * np.log(stretch)[:, None])

    def power(x):
        return Node(np.log([x]), stretch * np.log(x), stretch[:, None])

    for of, most in ((exponential, 0.03), (power, 1e-4)):
        found = Surrogate([of(each) for each in (2.0, 5.0, 8.0)])
        y, slope = found(np.log([20.0]))
        expected = of(20.0)
        np.testing.assert_allclose(y, expected.y, rtol=most)
        np.testing.assert_allclose(slope, expected.slope, rtol=4 * most)
