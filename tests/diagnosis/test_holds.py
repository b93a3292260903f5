"""Relaxation read from a load-cell record."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from limbcli.diagnosis.data.held_forces import STEP_S, held_forces, is_steady, relaxing, stretches
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Reading
from limbcli.measurement.indentation import Levels, Trace

DEPTHS = np.array([0.0, 3.0, 6.0, 9.0])
HOLD_S, RAMP_S, RATE_HZ = 20.0, 1.0, 60.0
A_HOLD = 5  # ratios: of 0 to 0.5, 0.5 to 1, 1 to 2, 2 to 4, 4 to 8 and 8 to 20 s, each over the next
CURVES = Curves(np.linspace(0, 10, 21), 0.12 * np.linspace(0, 10, 21) ** 1.5, np.zeros((21, 0)), np.zeros(0))


def record(rng, *, shares=(), depth=True, noise=0.02, hold=HOLD_S) -> Trace:
    """Ramps and holds at fixed depth, relaxing by terms (share, tau); integrated sample by sample."""
    step = 1.0 / RATE_HZ
    pieces = [np.full(round(hold * RATE_HZ), DEPTHS[0])]
    for a, b in pairwise(DEPTHS):
        pieces += [np.linspace(a, b, round(RAMP_S * RATE_HZ)), np.full(round(hold * RATE_HZ), b)]
    path = np.concatenate(pieces)
    elastic = 0.12 * path**1.5
    force = elastic.copy()
    for share, tau in shares:
        state = 0.0
        for k in range(1, len(path)):
            state = state * np.exp(-step / tau) + (elastic[k] - elastic[k - 1])
            force[k] += share * state
    force = force + noise * rng.standard_normal(len(force))
    shown = path + 0.02 * rng.standard_normal(len(path)) if depth else None
    return Trace(step * np.arange(len(path)), force, shown, None, None, Path("trace.csv"))


def levels() -> Levels:
    n, nan = len(DEPTHS), np.full(len(DEPTHS), np.nan)
    force = 0.12 * DEPTHS**1.5
    return Levels(
        force=force,
        depth=DEPTHS,
        swe_mean_m_per_s=nan,
        swe_sd_m_per_s=nan,
        swe_pixels=nan,
        phase=("load",) * n,
        hold=np.full(n, HOLD_S),
        probe_travel=nan,
        skin_bone=nan,
        path=Path("x"),
    )


def test_relaxing_force_of_a_ramp_is_the_convolution():
    tau, t = 3.0, STEP_S * np.arange(80)
    ramp = np.minimum(t, 5.0)
    exact = tau * (1 - np.exp(-t / tau))
    exact = np.where(t > 5, tau * (np.exp(5 / tau) - 1) * np.exp(-t / tau), exact)
    assert relaxing(ramp, tau) == pytest.approx(exact, abs=1e-12)


def test_a_pause_of_the_record_is_no_hold_and_the_hold_after_it_is_not_used(rng):
    whole = record(rng)
    start = len(DEPTHS[:-1]) * HOLD_S + (len(DEPTHS) - 2) * RAMP_S  # of the last ramp
    late = whole.time > start + RAMP_S
    keep = late | (whole.time < start)
    time = whole.time + 60.0 * late
    assert whole.depth is not None
    paused = Trace(time[keep], whole.force[keep], whole.depth[keep], None, None, whole.path)
    found, _ = held_forces(paused, levels())
    assert found is not None
    assert len(found) == len(held_forces(whole, levels())[0]) - A_HOLD
    assert STEP_S * found.windows.max() <= start + 1.0


def test_plateaus_are_the_holds(rng):
    found = held_forces(record(rng), levels())[0]
    assert found is not None
    assert len(found) == 2 * A_HOLD  # two holds carry more than 1 N
    assert found.place.tolist() == [*range(A_HOLD)] * 2
    assert len(stretches(is_steady(found.depth))) == len(DEPTHS)


def test_elastic_record_falls_by_nothing_and_is_predicted_so(rng):
    found, _ = held_forces(record(rng), levels())
    assert np.all(np.abs(found.y) < 4 * np.sqrt(np.diag(found.covariance)))
    assert found.predict(CURVES, Reading()) == pytest.approx(np.zeros(len(found)), abs=3e-3)


def test_relaxing_record_is_predicted_by_its_own_terms(rng):
    shares = ((0.4, 2.0), (0.2, 15.0))
    found, _ = held_forces(record(rng, shares=shares), levels())
    z = (found.y - found.predict(CURVES, Reading(prony=shares))) / np.sqrt(np.diag(found.covariance))
    assert np.sqrt(np.mean(z**2)) < 2.0
    without = (found.y - found.predict(CURVES, Reading())) / np.sqrt(np.diag(found.covariance))
    assert np.max(np.abs(without)) > 10.0


@pytest.mark.parametrize("hold", [4.0, 20.0, 60.0])
def test_other_causes_make_the_same_of_a_hold_however_many_ratios_it_gives(rng, hold):
    found, _ = held_forces(record(rng, noise=0.0, hold=hold, depth=False, shares=((0.4, 2.0),)), levels())
    begins = np.append(np.flatnonzero(found.place == 0), len(found))
    wholes = [found.covariance[a:b, a:b].sum() for a, b in pairwise(begins.tolist())]
    assert np.sqrt(wholes) == pytest.approx(0.006, rel=1e-2)


def test_two_relaxation_times_are_told_from_one(rng):
    """A decade apart, at fixed times that are not quite the true ones."""
    found, _ = held_forces(record(rng, shares=((0.5, 1.2), (0.3, 14.0))), levels())
    root = np.linalg.inv(np.linalg.cholesky(found.covariance))

    def left(shares: np.ndarray, times: Sequence[float]) -> np.ndarray:
        prony = tuple(zip(shares.tolist(), times, strict=True))
        return np.asarray(root @ (found.y - found.predict(CURVES, Reading(prony=prony))))

    def least(*times: float) -> float:
        start = np.full(len(times), 0.2)
        return 2.0 * least_squares(left, start, bounds=(0.0, 3.0), args=(times,)).cost

    one = min(least(tau) for tau in np.geomspace(0.5, 60.0, 15))
    assert least(1.0, 10.0) < 2.0 * len(found)
    assert one > least(1.0, 10.0) + 25.0


def test_without_depth_a_steady_force_says_nothing_and_a_falling_one_does(rng):
    found, why = held_forces(record(rng, depth=False), levels())
    assert found is None
    assert "held by hand" in why
    falling, _ = held_forces(record(rng, depth=False, shares=((0.5, 4.0),)), levels())
    assert falling is not None
    assert falling.depth[-1] == pytest.approx(DEPTHS[-1])


def test_depth_that_creeps_under_a_steady_force_tells_relaxation_too(rng):
    """A force held by hand: the depth grows meanwhile, and an elastic model then wants more force."""
    trace = record(rng, noise=0.0)
    t = trace.time
    creeping = trace.depth + 0.6 * (trace.depth > 8) * (1 - np.exp(-(t - t[trace.depth > 8][0]) / 5.0))
    steady = Trace(t, trace.force, creeping, None, None, trace.path)
    found, _ = held_forces(steady, levels())
    last = found.predict(CURVES, Reading())[-A_HOLD:].sum()
    deviation = np.sqrt(found.covariance[-A_HOLD:, -A_HOLD:].sum())
    assert last < -3.5 * deviation  # the elastic force rises, the measured one does not
    assert abs(found.y[-A_HOLD:].sum()) < 2 * deviation


def test_a_small_step_between_two_holds_is_not_taken_for_a_hold(rng):
    """The last step is a sixth of the others."""
    trace = record(rng)
    last = trace.time > trace.time[-1] - 20.0
    ramp = np.clip((trace.time - (trace.time[-1] - 21.0)) / 1.0, 0.0, 1.0)
    depth = trace.depth + 0.5 * ramp
    force = trace.force + 0.9 * ramp
    found, _ = held_forces(Trace(trace.time, force, depth, None, None, trace.path), levels())
    assert last.any()
    assert np.all(np.abs(found.y) < 5 * np.sqrt(np.diag(found.covariance)))


@pytest.mark.parametrize("shares", [(), ((0.4, 2.0), (0.2, 15.0))])
def test_a_step_that_the_recorded_depth_does_not_show_parts_two_holds(rng, shares):
    """Where the tissue is stiff, a depth may be read no deeper than the one before."""
    trace = record(rng, shares=shares)
    late = trace.time > 3 * HOLD_S + 2 * RAMP_S
    read = np.where(late, 5.98 + 0.02 * rng.standard_normal(len(late)), trace.depth)
    found, _ = held_forces(Trace(trace.time, trace.force, read, None, None, trace.path), levels())
    assert len(found) == 2 * A_HOLD
    parted = found.windows[A_HOLD, 0, 0] * STEP_S
    assert parted >= 3 * HOLD_S + 2 * RAMP_S
    if not shares:
        assert np.all(np.abs(found.y) < 4 * np.sqrt(np.diag(found.covariance)))


def test_what_neighbouring_ratios_of_one_hold_have_in_common_is_told():
    """The period that ends the first begins the second: its samples' noise is in both, with other signs."""
    rng, step = np.random.default_rng(5), 0.1
    path = np.concatenate([np.full(200, 0.0), np.linspace(0, 6, 10), np.full(200, 6.0)])
    drawn = []
    for _ in range(300):
        force = 0.12 * path**1.5 + 0.1 * rng.standard_normal(len(path))
        trace = Trace(step * np.arange(len(path)), force, path.copy(), None, None, Path("trace.csv"))
        found, _ = held_forces(trace, levels())
        assert found is not None
        drawn.append(np.linalg.solve(np.linalg.cholesky(found.covariance), found.y))
    alike = np.corrcoef(np.array(drawn).T)[np.triu_indices(A_HOLD, 1)]
    assert np.abs(alike).max() < 0.2  # 3.5 standard deviations of 300 draws
    assert found.covariance[0, 1] < -0.4 * found.covariance[0, 0]
