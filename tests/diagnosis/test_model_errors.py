"""What a model's own geometry leaves to doubt, in the numbers that the data have to allow for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.diagnosis.data import noise_parts
from limbcli.diagnosis.mesh_error.mesh_correction import MeshCorrection
from limbcli.diagnosis.mesh_error.numerical_checks import Intervention, Notes, NumericalChecks
from limbcli.effects.curves import Curves
from limbcli.measurement.levels import Levels
from limbcli.results import open_stage

DEPTH = np.array([0.0, 2.0, np.nan, 8.0])
N = len(DEPTH)


def errors_of(
    out: Path, *, thickness: float = 25.0, maps: str | None = None, hidden: Sequence[int] = ()
) -> NumericalChecks:
    """Four levels, one of which has no depth; ln speeds of the whole and of two parts, straight in depth.

    hidden : depths of the simulation, by their number, at which the second part is not shown
    """
    depth = np.linspace(0.0, 10.0, 6)
    slopes = np.array([0.02, 0.03, -0.01])
    speeds = np.outer(depth, slopes)
    speeds[list(hidden), 2] = np.nan
    curves = Curves(depth, depth, speeds, np.zeros(3), thickness)
    windows = SimpleNamespace(depths=np.zeros(3), n_parts=2, width_uncertainty=lambda log_speed: 0.01 * depth)
    simulations = SimpleNamespace(curves=lambda m: curves, windows=windows)
    nan = np.full(N, np.nan)
    levels = Levels(
        force=np.arange(N) * 1.0,
        depth=DEPTH,
        swe_mean_m_per_s=nan,
        swe_sd_m_per_s=nan,
        swe_pixels=nan,
        phase=("load",) * N,
        hold=nan,
        probe_travel=nan,
        skin_bone=nan,
        path=Path("levels.csv"),
    )
    checks = NumericalChecks(
        case=SimpleNamespace(imaging=SimpleNamespace(assumed="")), site=SimpleNamespace(swe_maps=maps),
        levels=levels, simulations=simulations, out=out, size=5.0, notes=Notes(), progress=None,
    )  # fmt: skip
    checks.depth, checks.likely_m = DEPTH, 4.0
    return checks


def with_voxels(out: Path, spacing: list[float]) -> None:
    with open_stage(out, "segment", subject="x") as writer:
        writer.data["image"] = {"spacing_mm": spacing}


CORRECTION = MeshCorrection(
    m=np.ones(1), logs=np.zeros((1, 6, 4)), thickness_ratio=1.0,
    mesh_error=np.full(N, 0.02), speed_error=np.full(N, 0.004),
)  # fmt: skip


def every(checks: NumericalChecks):
    change = np.full(N, 0.3)
    crop = Intervention("crop", change, np.zeros((N, 3)), 4.0, left=0.3)
    locking = Intervention("locking", change, np.zeros((N, 3)), 4.0)
    return {
        each.name.removeprefix("model: "): each
        for each in checks.known_errors(CORRECTION, [crop, locking]).errors
    }


@pytest.mark.parametrize(("spacing", "touch"), [([2.0, 2.0, 2.0], 1.0), ([1.0, 1.0, 8.0], 1.0), (None, 0.2)])
def test_first_touch_is_known_to_half_a_voxels_edge(spacing, touch, tmp_path):
    """And with it the thickness, in hypotenuse with the 3 % by which a limb is another on another day."""
    if spacing is not None:
        with_voxels(tmp_path, spacing)
    found = every(errors_of(tmp_path))
    assert found["depth at first touch"].depth == pytest.approx(touch)
    assert found["strain by the thickness"].strain == pytest.approx(np.hypot(touch / 25.0, 0.02))
    assert found["gain of the force by the geometry"].log_force == pytest.approx(0.07)


def test_what_is_still_in_doubt_of_a_numerical_change_counts_and_locking_does_not(tmp_path):
    found = every(errors_of(tmp_path))
    assert found["crop"].log_force == pytest.approx(0.09)
    assert "locking" not in found
    assert found["mesh"].log_force == pytest.approx(0.02)


def test_means_and_maps_err_by_what_is_theirs(tmp_path):
    """The mean: by mesh, window, and strain times how far the speeds of the two parts are apart."""
    means, maps = every(errors_of(tmp_path)), every(errors_of(tmp_path, maps="maps"))
    assert not {"mesh, in the mean speed", "width of the window"} & set(maps)
    width = means["width of the window"].log_speed
    assert width[:, 0] == pytest.approx([0.0, 0.02, 0.0, 0.08])
    assert not width[:, 1:].any()
    two = np.exp(np.outer([0.0, 2.0, 0.0, 8.0], [0.03, -0.01]))
    of_spread = (
        noise_parts.IN_MEAN * two.std(axis=1) / two.mean(axis=1) * np.array([0.0, 2.0, 0.0, 8.0]) / 25.0
    )
    mesh = means["mesh, in the mean speed"].log_speed
    assert mesh[:, 0] == pytest.approx(np.hypot(0.004, of_spread))
    assert of_spread[3] > 0.004
    one = every(errors_of(tmp_path, hidden=(4,)))["mesh, in the mean speed"].log_speed
    assert one[3, 0] == pytest.approx(0.004), "with one part shown nothing is apart"
    slopes = errors_of(tmp_path, maps="maps").known_errors(CORRECTION, []).map_slopes
    assert slopes == pytest.approx(np.tile([0.03, -0.01], (3, 1)))


@pytest.mark.parametrize("hidden", [(), (0,), (3,), (4, 5)])
def test_a_part_counts_if_the_model_shows_it_at_every_depth(hidden, tmp_path):
    seen = errors_of(tmp_path, maps="maps", hidden=hidden).parts_seen()
    assert seen.tolist() == [True, not hidden]


@pytest.mark.parametrize("hidden", [(), (0,), (3,), (2, 5), (4, 5)])
def test_the_slope_of_a_part_is_that_of_the_depths_at_which_it_is_shown(hidden, tmp_path):
    slopes = errors_of(tmp_path, maps="maps", hidden=hidden).known_errors(CORRECTION, []).map_slopes
    assert slopes == pytest.approx(np.array([[0.03, -0.01]] * 3), abs=1e-12)
