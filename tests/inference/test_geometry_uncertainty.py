"""A doubt of the model's shape as covariance: exact against the closed form, never a gain in sureness."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import no_narrower, shifts
from limbcli.inference.profile import Profile
from limbcli.numbers.modes import at_depths


def test_a_mode_like_a_parameter_moves_that_parameter_alone(rng):
    columns = rng.normal(size=(8, 2))
    moved = np.stack([0.3 * columns[:, 1], columns[:, 0] - columns[:, 1]], axis=1)
    assert shifts(columns, moved) == pytest.approx(np.array([[0.0, 0.3], [1.0, -1.0]]))


def test_modes_are_read_at_the_measured_depths():
    assert at_depths(np.array([[0.0, 2.0]]), np.array([1.0, 2.0]), np.array([1.5, 9.0])).ravel() == (
        pytest.approx([1.0, 2.0])
    )


def parabola(centre: float, half: float, limit: float, *, n: int = 81) -> Intervals:
    """Intervals of one parameter: the deviance, a parabola in ln, is at its limit `half` from the centre."""
    logs = np.linspace(np.log(centre) - 1.3 * half, np.log(centre) + 1.3 * half, n)
    logs = np.unique(np.r_[logs, np.log(centre) - half, np.log(centre) + half])
    deviance = limit * ((logs - np.log(centre)) / half) ** 2
    low, high = centre * np.exp(-half), centre * np.exp(half)
    thetas = np.exp(logs)[:, None]
    found = Profile("m", np.exp(logs), deviance, thetas, low, high, False, False, np.array([[low], [high]]))
    return Intervals({"m": found}, np.array([centre]), 3.0, 3, 1.0, limit, 0, None)


def crossings(profile: Profile, limit: float) -> tuple[float, float]:
    inside = profile.values[profile.deviance <= limit + 1e-9]
    return float(inside.min()), float(inside.max())


@pytest.mark.parametrize(
    ("wide", "narrow"),
    [
        (parabola(4.0, 0.8, 3.84), parabola(4.0, 0.3, 9.9)),  # the noise alone is narrower
        (parabola(4.0, 0.3, 3.84), parabola(4.0, 0.8, 9.9)),  # the scatter counts as noise: it is wider
        (parabola(3.0, 0.5, 3.84), parabola(5.0, 0.5, 9.9)),  # each is wider on one side
    ],
)
def test_the_profile_crosses_the_limit_where_its_interval_ends(wide, narrow):
    found = no_narrower(wide, narrow)
    profile = found.profiles["m"]
    assert (profile.low, profile.high) == pytest.approx(
        (
            min(each.profiles["m"].low for each in (wide, narrow)),
            max(each.profiles["m"].high for each in (wide, narrow)),
        )
    )
    assert crossings(profile, found.threshold) == pytest.approx((profile.low, profile.high), rel=1e-6)
    assert not profile.ends_beyond(found.threshold)
    assert profile.thetas.shape == (len(profile.values), 1)


def test_an_interval_extended_to_the_published_fit_says_so():
    profile = parabola(4.0, 0.3, 3.84).profiles["m"]
    extended = Profile("m", profile.values, profile.deviance, profile.thetas, 2.0, *(
        getattr(profile, name) for name in ("high", "open_low", "open_high", "ends")
    ))  # fmt: skip
    assert extended.ends_beyond(3.84)
