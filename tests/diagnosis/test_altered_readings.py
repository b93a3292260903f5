"""Readings altered before a diagnosis: the answer is inside its interval, or they are refused or doubted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.diagnosis.explanations.conclusions import Diagnosis
from limbcli.diagnosis.explanations.residuals import force_jump
from limbcli.diagnosis.explanations.sentences import sentences
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.effects.reading import Reading
from limbcli.errors import MeasurementError
from limbcli.measurement.indentation import read_levels
from limbcli.reporting.sections.diagnosis import _MOODS
from tests.diagnosis.test_reduced_site import bench, levels

C_KPA, M = 6.5, 4.0
READ = levels(np.random.default_rng(7))
FORCE, DEPTH, SPEED = READ.force, READ.depth, READ.swe_mean_m_per_s
NEW_TARE = 0.8 * (np.arange(len(READ)) >= len(READ) // 2)
KEPT = np.r_[0:4, 10 : len(READ)]
REFUSED = {
    "kgf as N": (FORCE / 9.80665, DEPTH, SPEED),
    "lbf as N": (FORCE / 4.44822, DEPTH, SPEED),
    "N as kgf": (FORCE * 9.80665, DEPTH, SPEED),
    "cm as mm": (3.0 * FORCE, DEPTH / 10.0, SPEED),  # the reduced block is a third as stiff as a limb
    "inch as mm": (FORCE, DEPTH / 25.4, SPEED),
    "cm/s as m/s": (FORCE, DEPTH, SPEED * 100.0),
    "km/h as m/s": (FORCE, DEPTH, SPEED * 3.6),
    "reversed": (FORCE[::-1], DEPTH[::-1], SPEED[::-1]),
    "depths reversed": (FORCE, DEPTH[::-1], SPEED),
}
RIGHT = {
    "as read": (FORCE, DEPTH, SPEED),
    "no level 0": (FORCE[1:], DEPTH[1:], SPEED[1:]),
    "a gap": (FORCE[KEPT], DEPTH[KEPT], SPEED[KEPT]),
    "no upper half": (FORCE[:6], DEPTH[:6], SPEED[:6]),
}
DOUBTED = {
    "speeds reversed": (FORCE, DEPTH, SPEED[::-1]),
    "forces of the level before": (FORCE[:-1], DEPTH[1:], SPEED[1:]),
    "two tares": (FORCE + NEW_TARE, DEPTH, SPEED),
}


def written(path: Path, columns: tuple[np.ndarray, ...]) -> Path:
    rows = [",".join(f"{each:.4f}" for each in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join(["force_n,depth_mm,swe_mean_m_per_s", *rows]) + "\n")
    return path


def modelled(path: Path, columns: tuple[np.ndarray, ...]) -> SiteForwardModel:
    read = read_levels(written(path, columns))
    model = bench(replace(read, hold=np.full(len(read), 20.0)))
    model.settle_noise()
    return model


def found(path: Path, columns: tuple[np.ndarray, ...]) -> Diagnosis:
    return diagnose(modelled(path, columns), max_effects=1)


@pytest.mark.parametrize("columns", REFUSED.values(), ids=REFUSED)
def test_readings_in_another_unit_or_order_are_refused(tmp_path: Path, columns) -> None:
    with pytest.raises(MeasurementError) as refused:
        read_levels(written(tmp_path / "levels.csv", columns))
    assert "\n  fix:" in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("columns", RIGHT.values(), ids=RIGHT)
def test_lost_levels_leave_the_tissue_within_its_intervals(tmp_path: Path, columns) -> None:
    result = found(tmp_path / "levels.csv", columns)
    assert result.verdict == "adequate"
    for name, truth in (("c_kpa", C_KPA), ("m", M)):
        low, high = result.estimates.intervals[name]
        assert low < truth < high, name


@pytest.mark.slow
@pytest.mark.parametrize("columns", DOUBTED.values(), ids=DOUBTED)
def test_readings_that_no_tissue_gives_are_doubted(tmp_path: Path, columns) -> None:
    result = found(tmp_path / "levels.csv", columns)
    assert result.verdict in ("ambiguous", "unexplained")
    assert _MOODS.get(result.verdict, "warning") == "warning"
    first = sentences(result)[0]
    assert first.startswith(("AMBIGUOUS: several explanations", "UNEXPLAINED: something is missing"))


def test_levels_of_loading_that_fall_slowly_are_refused(tmp_path: Path) -> None:
    """Each step is within what a load cell may lose; together they are an order."""
    with pytest.raises(MeasurementError, match=r"force_n falls from 3\.\d+ N"):
        read_levels(written(tmp_path / "levels.csv", REFUSED["reversed"]))


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_second_tare_is_told_beside_the_effect_that_it_resembles(tmp_path: Path, sign: float) -> None:
    """Downwards it is named as a force that relaxes, with c far too low."""
    model = modelled(tmp_path / "levels.csv", (FORCE + sign * NEW_TARE, DEPTH, SPEED))
    result = diagnose(model, max_effects=1)
    assert result.verdict != "adequate"
    explained = result.shrink[0].chi2 - result.shrink[-1].chi2
    jump = force_jump(model.data, result.base, explained=explained)
    assert jump is not None
    assert 0.4 < sign * jump.size < 1.6  # to first order, beside a fit that the jump has pulled away
    assert jump.level == len(READ) // 2


@pytest.mark.slow
def test_an_offset_of_all_forces_is_no_jump(tmp_path: Path) -> None:
    read = levels(np.random.default_rng(7), reading=Reading(force_zero=1.0))
    columns = (read.force, read.depth, read.swe_mean_m_per_s)
    model = modelled(tmp_path / "levels.csv", columns)
    result = diagnose(model, max_effects=1)
    explained = result.shrink[0].chi2 - result.shrink[-1].chi2
    assert force_jump(model.data, result.base, explained=explained) is None
