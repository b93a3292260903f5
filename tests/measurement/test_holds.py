"""Holds: found where they are, averaged with an honest error, and what is unsteady is said."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.holds import find_holds, missing_levels, without_probe_weight
from limbcli.measurement.indentation import Trace

RATE = 60.0


def record(rng, levels=(0, 2, 4, 6), hold=10.0, ramp=2.0, *, noise=0.03, drift=0.0, correlation=0.0):
    """Ramps and holds at `levels`, the last drifting by `drift` N/s."""
    parts, last = [], levels[0]
    for k, level in enumerate(levels):
        parts.append(np.linspace(last, level, int(ramp * RATE)))
        slope = drift if k == len(levels) - 1 else 0.0
        parts.append(level + slope * np.arange(int(hold * RATE)) / RATE)
        last = level
    force = np.concatenate(parts)
    white = rng.standard_normal(len(force))
    for k in range(1, len(white)):
        white[k] = correlation * white[k - 1] + np.sqrt(1 - correlation**2) * white[k]
    time = np.arange(len(force)) / RATE
    return Trace(time, force + noise * white, None, None, None, Path("trace.csv"))


def test_every_hold_is_found_with_its_mean(rng):
    holds = find_holds(record(rng), tolerance=0.1, duration_s=5.0)
    np.testing.assert_allclose([each.force for each in holds], [0, 2, 4, 6], atol=0.02)
    assert all(9.0 < each.duration_s < 12.6 for each in holds)
    assert not any(each.creeping for each in holds)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_standard_error_is_right_for_correlated_noise_too(correlation):
    errors, stated = [], []
    for seed in range(40):
        trace = record(np.random.default_rng(seed), levels=(0, 2), correlation=correlation)
        hold = find_holds(trace)[1]
        errors.append(hold.force - 2.0)
        stated.append(hold.force_se)
    # 40 repeats give the SD to 11 %; batch means of a 10 s hold lose some more
    assert np.std(errors) == pytest.approx(np.mean(stated), rel=0.4)


def test_drift_within_a_hold_is_said(rng):
    holds = find_holds(record(rng, drift=0.015), tolerance=0.15)
    assert [each.creeping for each in holds] == [False, False, False, True]
    assert holds[-1].drift_n_per_s == pytest.approx(0.015, abs=0.005)


def test_a_ramp_that_ends_above_its_hold_is_told_by_how_much(rng):
    """Half a newton too far for half a second before the hold at 4 N; before the one at 6 N nothing."""
    trace = record(rng, noise=0.01)
    beyond = trace.force.copy()
    first = int(find_holds(trace)[2].start_s * RATE)
    beyond[first + 15 : first + 45] += 0.5
    holds = find_holds(replace(trace, force=beyond))
    assert holds[2].overshoot == pytest.approx(0.5, abs=0.06)
    assert holds[3].overshoot < 0.15


@pytest.mark.parametrize("gaps", [False, True])
def test_tissue_that_gives_way_under_a_steady_force_creeps(rng, gaps):
    """0.02 mm/s in the last hold, in which the force stays; depths may be read at some of the samples."""
    trace = record(rng)
    end = find_holds(trace)[-1].end_s
    depth = (
        3.0 + 0.02 * np.maximum(trace.time - (end - 10.0), 0.0) + 0.01 * rng.standard_normal(len(trace.time))
    )
    if gaps:
        depth[::3] = np.nan
    holds = find_holds(replace(trace, depth=depth))
    assert [each.creeping for each in holds] == [False, False, False, True]
    assert holds[-1].depth_drift_mm_per_s == pytest.approx(0.02, rel=0.15)
    assert holds[-1].depth == pytest.approx(3.1, abs=0.02)
    assert holds[1].depth == pytest.approx(3.0, abs=4 * holds[1].depth_se)


def test_dropouts_and_spikes_do_not_break_a_hold(rng):
    trace = record(rng)
    force, keep = trace.force.copy(), np.ones(len(trace.force), dtype=bool)
    force[500] = 40.0
    keep[900:920] = False
    holds = find_holds(Trace(trace.time[keep], force[keep], None, None, None, trace.path))
    assert len(holds) == 4
    assert [each.n_dropouts for each in holds] == [0, 1, 0, 0]


def test_readings_one_step_of_the_load_cell_apart_are_no_spikes(rng):
    trace = record(rng, levels=(0, 2.03, 4.06))
    coarse = replace(trace, force=np.round(trace.force / 0.1) * 0.1)
    holds = find_holds(coarse)
    assert [each.n_spikes for each in holds] == [0, 0, 0]
    np.testing.assert_allclose([each.force for each in holds], [0, 2.03, 4.06], atol=0.02)


def test_a_record_without_spikes_has_none_at_the_ends_of_its_holds(rng):
    holds = find_holds(record(rng, noise=0.005))
    assert [each.n_spikes for each in holds] == [0, 0, 0, 0]
    np.testing.assert_allclose([each.force for each in holds], [0, 2, 4, 6], atol=0.005)


@pytest.mark.parametrize("every", [1, 60])
def test_depth_and_travel_may_be_read_less_often_than_the_force(rng, every):
    trace = record(rng)
    depth = np.where(np.arange(len(trace.time)) % every == 0, 1.5 * trace.force, np.nan)
    holds = find_holds(replace(trace, depth=depth, probe_travel=100.0 + depth))
    np.testing.assert_allclose([each.depth for each in holds], [0, 3, 6, 9], atol=0.05)
    np.testing.assert_allclose([each.probe_travel for each in holds], [100, 103, 106, 109], atol=0.05)


def test_a_fast_record_is_looked_at_in_the_memory_of_some_copies_of_it(rng):
    force = np.repeat([0.0, 2.0, 4.0], 3000) + 0.02 * rng.standard_normal(9000)
    trace = Trace(np.arange(len(force)) / 1000.0, force, None, None, None, Path("trace.csv"))
    tracemalloc.start()
    holds = find_holds(trace, duration_s=2.0)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose([each.force for each in holds], [0, 2, 4], atol=0.005)
    assert most < 40 * force.nbytes


def test_record_without_holds_says_how_near_it_came(rng):
    time = np.arange(600) / RATE
    trace = Trace(time, 2.0 * time, None, None, None, Path("trace.csv"))
    with pytest.raises(MeasurementError, match=r"no hold of 5 s .* longest lasts"):
        find_holds(trace)


def test_missing_level_is_named(rng):
    holds = find_holds(record(rng, levels=(0, 2, 6)))
    assert missing_levels(holds) == [4.0]


def test_weight_of_a_turned_probe_is_taken_off(rng):
    angle = np.deg2rad(np.r_[np.zeros(300), np.full(600, 60.0)])
    cosine = np.cos(angle)
    force = np.r_[np.zeros(300), np.full(600, 5.0)]
    read = 1.3 + force + 0.3 * 9.80665 * (cosine - 1.0)
    time = np.arange(900) / RATE
    gravity = np.column_stack([np.sin(angle), np.zeros(900), cosine])
    trace = Trace(time, read, None, None, gravity, Path("trace.csv"))
    mended = without_probe_weight(trace, probe_mass_kg=0.3, tare_s=(0.0, 4.0))
    np.testing.assert_allclose(mended.force[400:], 5.0, atol=0.01)
    gravity[1::2] = np.nan  # read at half the rate
    half = without_probe_weight(trace, probe_mass_kg=0.3, tare_s=(0.0, 4.0))
    np.testing.assert_allclose(half.force[400:], 5.0, atol=0.01)
    unmended = without_probe_weight(trace, probe_mass_kg=0.0, tare_s=(0.0, 4.0))
    assert abs(unmended.force[400:].mean() - 5.0) > 1.0


def test_accelerations_that_are_not_in_g_take_off_no_weight(rng):
    trace = record(rng)
    still = np.tile([0.0, 0.0, 9.81], (len(trace.time), 1))
    with pytest.raises(MeasurementError, match=r"9\.81 g while the probe hangs free.*\n.*\n.*m/s2"):
        without_probe_weight(replace(trace, acceleration_g=still), probe_mass_kg=0.3, tare_s=(0.0, 4.0))


def test_weight_without_accelerometer_and_tare_outside_the_record_are_refused(rng):
    trace = record(rng)
    with pytest.raises(MeasurementError, match="without its orientation"):
        without_probe_weight(trace, probe_mass_kg=0.3, tare_s=(0.0, 1.0))
    with pytest.raises(MeasurementError, match="no sample lies within"):
        without_probe_weight(trace, probe_mass_kg=0.0, tare_s=(-9.0, -8.0))


def test_a_spike_in_a_hold_does_not_move_its_mean(rng):
    trace = record(rng)
    hold = find_holds(trace)[2]
    force = trace.force.copy()
    force[np.searchsorted(trace.time, hold.start_s + 2.0)] = 90.0
    spiked = find_holds(replace(trace, force=force))[2]
    assert spiked.n_spikes == 1
    assert spiked.force == pytest.approx(hold.force, abs=1e-3)
    assert spiked.force_se < 2 * hold.force_se
