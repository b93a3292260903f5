"""Simulated curves written by `fit` to curves.csv and swe.csv, or by `run` to force-depth.csv."""

from __future__ import annotations

import csv

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array
from limbcli.reporting.figures.force_depth import SimulatedCurve
from limbcli.reporting.figures.wave_speed import PredictedSpeeds
from limbcli.results import StageResult

CURVES_FILE, RUN_CURVE_FILE = "curves.csv", "force-depth.csv"
_LABELS = {
    "start": "start (f_κ = 100, m = 2)",
    "mooney-rivlin": "Mooney-Rivlin type (m = 2)",
    "ogden": "Ogden type",
}
_DEPTH, _MEASURED, _FORCE_UNIT = "depth_mm", "measured_n", "_n"
_SAME_DEPTH = 1e-4  # tolerance (mm) of equal depths; the file has six digits


def read_curves(result: StageResult, measured_depth: Array | None = None) -> tuple[SimulatedCurve, ...]:
    """All simulated force columns, with values at the measured depths if the file has them.

    measured_depth : (n_levels,) mm

    Raises CaseError if the file is missing or a value is not a number.
    """
    columns = _columns(result, result.files.get("curves", CURVES_FILE))
    depth = columns.pop(_DEPTH)
    columns.pop(_MEASURED, None)
    return tuple(
        _curve(name.removesuffix(_FORCE_UNIT), depth, force, measured_depth)
        for name, force in columns.items()
        if name.endswith(_FORCE_UNIT)
    )


def read_run_curve(result: StageResult) -> SimulatedCurve:
    """The simulation with start values, for a site that has not been fitted. Raises as `read_curves`."""
    columns = _columns(result, result.files.get("force_depth", RUN_CURVE_FILE), needed=(_DEPTH, "force_n"))
    depth, force = (np.r_[0.0, columns[name]] for name in (_DEPTH, "force_n"))
    return SimulatedCurve("start", "simulation with start values", depth, force)


def read_predicted_speeds(result: StageResult) -> PredictedSpeeds | None:
    """Mean shear-wave speeds predicted by the fitted model, or None if the fit wrote none.

    Raises as `read_curves`.
    """
    if "swe" not in result.files:
        return None
    needed = ("simulated_force_n", _DEPTH, "predicted_m_per_s")
    columns = _columns(result, result.files["swe"], needed=needed)
    return PredictedSpeeds(*(columns[name] for name in needed))


def _columns(result: StageResult, name: str, *, needed: tuple[str, ...] = (_DEPTH,)) -> dict[str, Array]:
    path = result.folder / name
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        columns = {
            column: np.array([float(row[column]) if row[column] != "" else np.nan for row in rows])
            for column in (rows[0] if rows else {})
        }
        lacking = [each for each in needed if each not in columns]
        if lacking:
            raise ValueError(f"they lack the column {', '.join(lacking)}")
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise CaseError(
            f"the curves of “{result.stage}” cannot be read ({type(error).__name__}: {error})",
            where=str(path),
            fix=f"run `limbcli {result.stage}` again",
        ) from error
    return columns


def _curve(key: str, depth: Array, force: Array, measured_depth: Array | None) -> SimulatedCurve:
    label = _LABELS.get(key, key)
    if measured_depth is None:
        return SimulatedCurve(key, label, depth, force)
    gap = np.abs(depth[None, :] - np.maximum(measured_depth, 0.0)[:, None])
    nearest = gap.argmin(axis=1)
    sampled = np.where(gap.min(axis=1) < _SAME_DEPTH, force[nearest], np.nan)
    return SimulatedCurve(key, label, depth, force, sampled)
