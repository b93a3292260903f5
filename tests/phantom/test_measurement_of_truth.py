"""Reading off what is true: noise as stated, levels as protocolled, files as the format has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from limbcli.errors import SolveError
from limbcli.measurement import indentation
from limbcli.measurement.elastography import SweMap, read_maps
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.phantom.protocol import LoadingProtocol, TrueLevels, depth_at_force
from limbcli.phantom.simulated_readings import levels_rows, measure, write_readings

PROTOCOL = LoadingProtocol(hold=2.0)


def true_levels(n=6):
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-12.0, 13), np.arange(2.0, 26)))
    maps = tuple(SweMap(x, z, np.full(x.size, 2.0 + 0.1 * k)) for k in range(n))
    return TrueLevels(2.0 * np.arange(n), 1.5 * np.arange(n), maps, skin_bone=40.0)


def test_depth_at_force_inverts_the_sampled_curve(rng):
    depth = np.linspace(0, 15, 16)
    force = 0.5 * depth + 0.05 * depth**2 + 0.01 * np.sin(depth)
    targets = np.array([0.0, 2.0, 8.0, force[-1]])
    found = depth_at_force(depth, force, targets)
    assert PchipInterpolator(depth, force)(found) == pytest.approx(targets, abs=1e-10)
    assert found[0] == 0


def test_a_gap_before_first_contact_is_no_fault():
    depth = np.arange(6.0)
    found = depth_at_force(depth, np.array([0.0, -0.0, 0.5, 1.5, 3.0, 5.0]), np.array([0.0, 3.0]))
    assert found == pytest.approx([0.0, 4.0])


def test_a_force_that_is_not_reached_or_falls_is_an_error():
    depth = np.arange(4.0)
    with pytest.raises(SolveError, match=r"reaches 3\.00 N"):
        depth_at_force(depth, depth, np.array([0.0, 4.0]))
    with pytest.raises(SolveError, match="does not increase"):
        depth_at_force(depth, np.array([0.0, 2.0, 1.0, 3.0]), np.array([1.0]))


def test_without_noise_the_readings_are_the_truth(rng):
    true = true_levels()
    readings = measure(true, NoiseLaw().times(0.0), protocol=PROTOCOL, rng=rng)
    assert np.array_equal(readings.force, true.force)
    assert np.array_equal(readings.depth, true.depth)
    for swe, expected in zip(readings.maps, true.maps, strict=True):
        assert np.array_equal(swe.speed_m_per_s, expected.speed_m_per_s)


def test_noise_has_the_stated_size_and_level_0_is_the_reference(rng):
    law = NoiseLaw()
    true = true_levels()
    several = [measure(true, law, protocol=PROTOCOL, rng=rng) for _ in range(300)]
    force = np.array([each.force - true.force for each in several])
    depth = np.array([each.depth - true.depth for each in several])
    assert not force[:, 0].any()
    assert not depth[:, 0].any()
    assert force[:, 1:].std() == pytest.approx(law.force_n, rel=0.06)
    assert depth[:, 1:].std() == pytest.approx(law.depth_mm, rel=0.06)
    ratio = [each.maps[2].speed_m_per_s / true.maps[2].speed_m_per_s for each in several]
    assert np.std([each.mean() for each in ratio]) == pytest.approx(law.swe_level_fraction, rel=0.12)
    assert np.mean([each.std() for each in ratio]) == pytest.approx(law.swe_pixel_fraction, rel=0.05)


def test_written_files_pass_the_programs_own_checks(tmp_path, rng):
    true = true_levels()
    readings = measure(true, NoiseLaw(), protocol=PROTOCOL, rng=rng)
    write_readings(tmp_path, readings)
    levels = indentation.read_levels(tmp_path / "levels.csv")
    assert levels.force == pytest.approx(readings.force, abs=1e-4)
    assert levels.depth == pytest.approx(readings.depth, abs=1e-5)
    assert levels.skin_bone == pytest.approx(40.0 - readings.depth, abs=1e-3)
    maps = read_maps(tmp_path / "swe", len(levels))
    means = [each.speed_m_per_s.mean() for each in maps]
    assert levels.swe_mean_m_per_s == pytest.approx(means, rel=1e-4)
    assert levels.swe_pixels.tolist() == [len(each) for each in maps]


def test_the_trace_holds_every_level_at_60_hz(tmp_path, rng):
    readings = measure(true_levels(), NoiseLaw(), protocol=PROTOCOL, rng=rng)
    write_readings(tmp_path, readings)
    trace = indentation.read_trace(tmp_path / "trace.csv")
    assert np.diff(trace.time) == pytest.approx(1 / 60, abs=2e-4)
    for k, force in enumerate(readings.force):
        start = k * (PROTOCOL.hold + PROTOCOL.ramp)
        held = trace.force[(trace.time > start + 0.05) & (trace.time < start + PROTOCOL.hold - 0.05)]
        assert len(held) > 100
        assert held.mean() == pytest.approx(force, abs=0.012)
        assert held.std() == pytest.approx(0.03, rel=0.25)
    assert np.linalg.norm(trace.acceleration_g, axis=1) == pytest.approx(1.0, abs=0.05)


def test_layers_are_read_with_their_own_noise_and_muscle_goes_down_to_the_bone(rng):
    true = true_levels(60)
    borders = np.column_stack([np.full(60, 1.5), 8.0 - 0.02 * np.arange(60)])
    seen = measure(replace(true, borders=borders), NoiseLaw(), protocol=PROTOCOL, rng=rng).layers
    assert seen.shape == (60, 3)
    off = seen[:, :2] - np.diff(borders, axis=1, prepend=0.0)
    assert off.std() == pytest.approx(NoiseLaw().layer_mm, rel=0.2)
    assert np.allclose(seen.sum(axis=1)[0], 40.0)
    exact = measure(replace(true, borders=borders), NoiseLaw().times(0.0), protocol=PROTOCOL, rng=rng)
    header, rows = levels_rows(exact)
    assert header[-3:] == ["skin_mm", "fat_mm", "muscle_mm"]
    assert [float(each) for each in rows[10][-3:]] == pytest.approx([1.5, 6.3, 40.0 - 15.0 - 7.8])
    assert measure(true, NoiseLaw(), protocol=PROTOCOL, rng=rng).layers is None
