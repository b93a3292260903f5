"""A cohort's columns against each other: what is redundant agrees, and a wrong unit of a column is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from limbcli.cohorts.column_checks import checked_cohort
from limbcli.cohorts.unit_guess import REACH
from limbcli.errors.problems import Problem
from limbcli.inference.layered_family import CONVEXITY, HIGH, LOW, layered_family
from tests.cohort_rows import FACE, people, written

Row = dict[str, str]


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    mean, spread = np.log([0.006, 0.010, 4.0]), np.diag([0.35, 0.3, 0.2]) ** 2
    return people(12, mean=mean, spread=spread, rng=np.random.default_rng(7))[0]


def times(name: str, factor: float) -> Callable[[Row], Row]:
    return lambda row: {**row, name: f"{float(row[name]) * factor:.9g}"}


def with_pressure(row: Row, *, factor: float = 1.0, digits: int = 9) -> Row:
    return {**row, "max_pressure_mpa": f"{factor * float(row['max_force_n']) / FACE:.{digits}g}"}


def errors(folder: Path, rows: list[Row]) -> list[Problem]:
    return [each for each in checked_cohort(written(folder / "t.csv", rows))[1] if each.severity == "error"]


@pytest.mark.parametrize("digits", [1, 2, 9])
def test_a_pressure_that_agrees_within_its_rounding_is_taken(tmp_path: Path, rows: list[Row], digits: int):
    assert errors(tmp_path, [with_pressure(each, digits=digits) for each in rows]) == []


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (3.5, "no unit"),
        (1 / 50, "no unit"),
        (1.05, "no unit"),
        (145.04, "psi"),
        (7500.6, "mmHg"),
        (4.448, "lbf"),
    ],
)
def test_a_pressure_that_is_not_force_over_face_is_refused(
    tmp_path: Path, rows: list[Row], factor: float, unit: str
):
    found = errors(tmp_path, [with_pressure(each, factor=factor) for each in rows])
    assert len(found) == 6
    assert found[0].what.startswith("max_pressure_mpa is")
    assert unit in found[0].fix


def test_one_row_that_disagrees_is_named(tmp_path: Path, rows: list[Row]):
    several = [with_pressure(each, factor=3.5 if k == 4 else 1.0) for k, each in enumerate(rows)]
    (found,) = errors(tmp_path, several)
    assert "by the factor 3.5" in found.what
    assert "6" in found.where, "the sixth line of the file"


@pytest.mark.parametrize(
    ("name", "factor", "unit"),
    [
        ("max_force_n", 1 / 4.4482, "max_force_n in lbf"),
        ("max_force_n", 1 / 9.80665, "max_force_n in kgf"),
        ("stiffness_mpa_per_mm", 145.04, "in psi per mm"),
        ("stiffness_mpa_per_mm", 7500.6, "in mmHg per mm"),
        ("stiffness_mpa_per_mm", 1000.0, "in kPa per mm"),
        ("stiffness_mpa_per_mm", 25.4, "in MPa per inch"),
        ("stiffness_mpa_per_mm", 3.0, "no unit"),
        ("stiffness_mpa_per_mm", 1 / 3.0, "no unit"),
    ],
)
def test_a_factor_common_to_all_rows_of_a_place_is_refused_and_named(
    tmp_path: Path, rows: list[Row], name: str, factor: float, unit: str
):
    elsewhere = [{**each, "location": "UL_A"} for each in rows]
    (found,) = errors(tmp_path, [*elsewhere, *map(times(name, factor), rows)])
    assert found.what.startswith("LL_P: pressure over displacement")
    assert unit in found.what


def test_people_of_any_tissue_are_taken(tmp_path: Path):
    """Not one table of the family's own people is refused, be their curves straight or strongly curved."""
    for seed, m in enumerate((1.8, 3.0, 6.0, 10.0)):
        mean, spread = np.log([0.006, 0.010, m]), np.diag([0.35, 0.3, 0.1]) ** 2
        some, _ = people(12, mean=mean, spread=spread, rng=np.random.default_rng(seed))
        assert errors(tmp_path, some) == []


def test_the_reach_of_the_curves_is_the_familys():
    x = LOW + (HIGH - LOW) * np.random.default_rng(7).random((5000, len(LOW)))
    low, high = np.percentile(layered_family()(x)[:, CONVEXITY], [1, 99])
    assert REACH[0] == pytest.approx(low, abs=0.05)
    assert REACH[1] == pytest.approx(high, abs=0.05)


def test_a_face_known_from_a_force_in_kilograms_is_refused(tmp_path: Path, rows: list[Row]):
    """With its face the same table is one of a small probe."""
    for size, is_told in ((9.80665, True), (1.0, False)):
        several = [{**times("max_force_n", 1 / size)(with_pressure(each)), "face_mm2": ""} for each in rows]
        table, problems = checked_cohort(written(tmp_path / "t.csv", several))
        assert (table is None) == is_told
        found = [each for each in problems if "force over pressure makes the probe's face" in each.what]
        assert [each.severity for each in found] == ["error"] * is_told
        faces = [{**each, "face_mm2": f"{float(each['max_force_n']) / float(each['max_pressure_mpa'])}"}
                 for each in several]  # fmt: skip
        assert checked_cohort(written(tmp_path / "t.csv", faces))[0] is not None


@pytest.mark.parametrize(("line", "parabola"), [(0.97, 0.90), (97.0, 99.0)])
def test_a_parabola_that_fits_worse_than_a_line_is_refused(
    tmp_path: Path, rows: list[Row], line: float, parabola: float
):
    several = [{**each, "r2_line": f"{line}", "r2_parabola": f"{parabola}"} for each in rows]
    assert "a parabola fits no worse" in errors(tmp_path, several)[0].what
