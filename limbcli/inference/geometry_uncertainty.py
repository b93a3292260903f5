"""Contribution of the uncertain geometry of the model to a force fit: modes of the simulated force.

Each mode is ln of the ratio of the force of a varied model to that of the fitted one, for a variation by one
standard deviation, at the simulated depths. A mode shifts all levels together, so it adds covariance to the
residuals: V = diag(noise) + U U', with U the modes in N at the measured depths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from limbcli.inference.adaptive import Intervals
from limbcli.inference.profile import Profile
from limbcli.model import Array


def shifts(columns: Array, moved: Array) -> Array:
    """Change of ln theta (n_modes, p) of a least-squares fit by each mode; columns (n, p) : d force / d ln
    theta, moved (n, n_modes) : N
    """
    return np.asarray((np.linalg.pinv(columns) @ moved).T)


def no_narrower(wide: Intervals, narrow: Intervals) -> Intervals:
    """The intervals with the geometry's uncertainty, but not narrower than those of the noise alone, as modes
    may explain scatter by which the noise was enlarged.

    Each profile is the curve that crosses the limit where its interval ends: that of the wider interval or,
    where each is wider on one side, the lower of the two.
    """
    ratio = wide.threshold / narrow.threshold  # of the units of the deviances
    scaled = {name: replace(each, deviance=each.deviance * ratio) for name, each in narrow.profiles.items()}
    profiles = {name: _wider(each, scaled[name]) for name, each in wide.profiles.items()}
    return replace(wide, profiles=profiles)


def _wider(wide: Profile, narrow: Profile) -> Profile:
    sides = _covers(wide, narrow), _covers(narrow, wide)
    if all(sides[0]):
        return wide
    if all(sides[1]):
        return narrow
    values = np.unique(np.r_[wide.values, narrow.values])
    roots = np.array([each.root_at(values) for each in (wide, narrow)])
    source = (wide, narrow)
    low, high = (source[int(not covers)] for covers in sides[0])
    nearest = [source[k] for k in roots.argmin(axis=0)]
    thetas = [each.thetas[np.abs(each.values - v).argmin()] for each, v in zip(nearest, values, strict=True)]
    return replace(
        wide, values=values, deviance=roots.min(axis=0) ** 2, thetas=np.array(thetas),
        low=low.low, high=high.high, open_low=low.open_low, open_high=high.open_high,
        ends=np.array([low.ends[0], high.ends[1]]),
    )  # fmt: skip


def _covers(one: Profile, other: Profile) -> tuple[bool, bool]:
    """Whether an interval reaches at least as far as another: (downwards, upwards)."""
    down = one.open_low or (not other.open_low and one.low <= other.low)
    up = one.open_high or (not other.open_high and one.high >= other.high)
    return down, up


def ends(intervals: Intervals) -> dict[str, list[float | None]]:
    """[low, high] by parameter; None where an interval is open."""
    return {name: list(each.limits) for name, each in intervals.profiles.items()}


def total_share(modes: Sequence[Array]) -> float:
    """Standard deviation of ln force due to all modes, root mean square over the depths; 0 without modes.

    >>> round(total_share([np.array([0.3, 0.3]), np.array([0.4, 0.4])]), 3)
    0.5
    """
    return float(np.sqrt(np.mean(np.sum(np.square(modes), axis=0)))) if len(modes) else 0.0
