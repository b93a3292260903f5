"""Comparison of the shear-wave speeds predicted by the fitted model with those measured.

The fit uses only the speed at level 0; the others are predictions from the deformation
(small waves superposed on a large deformation), on the pixels of the measured maps if there are any.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.drawing import save_figure
from limbcli.errors import LimbError
from limbcli.errors.problems import errors_of
from limbcli.feb.settings import LEAST_START
from limbcli.fitting.exports import write_table
from limbcli.fitting.stiffness_map import probe_length
from limbcli.measurement.elastography import SweMap, check_map, check_mean, check_width, map_file, write_map
from limbcli.measurement.indentation import Levels
from limbcli.model import Array, IntArray, LimbModel
from limbcli.model.patient_frame import patient_from_model, side_of
from limbcli.reporting.figures.speed_maps import LevelMaps, speed_maps
from limbcli.reporting.figures.wave_speed import PredictedSpeeds, SpeedReadings, wave_speed
from limbcli.results import StageWriter
from limbcli.shear_waves.from_simulation import AT_REST, level_maps
from limbcli.solvers.solver import Simulation

_SAME_DEPTH = 0.03  # mm, tolerance to match levels and simulated depths (those within 0.02 mm were merged)
FOLDER = "swe"


@dataclass(frozen=True, eq=False)
class Predicted:
    """Loading levels (row indices of levels.csv) with simulated force (N), predicted and measured maps."""

    levels: IntArray
    force: Array
    maps: tuple[SweMap, ...]
    measured: tuple[SweMap | None, ...]

    @property
    def mean_m_per_s(self) -> Array:
        return np.array([each.speed_m_per_s.mean() for each in self.maps])


def write_speeds(
    fitted: LimbModel, simulation: Simulation, levels: Levels, site: Site, writer: StageWriter
) -> None:
    """Write swe.csv, maps in swe/, swe.png and swe-maps.png; only a warning if nothing can be predicted."""
    try:
        found = _predict(fitted, simulation, levels, site, writer)
    except LimbError as error:
        writer.warnings.append(f"no shear-wave speeds could be predicted: {error.what}")
        return
    _write_speed_table(found, levels, writer)
    for row, each in zip(levels.rows[found.levels].tolist(), found.maps, strict=True):
        write_map(writer.file(f"swe_level_{row:02d}", map_file(Path(FOLDER), row).as_posix()), each)
    predicted = PredictedSpeeds(found.force, levels.depth[found.levels], found.mean_m_per_s)
    loading = levels.loading & np.isfinite(levels.swe_mean_m_per_s)
    readings = None
    if loading.any():
        readings = SpeedReadings(
            levels.force[loading], levels.depth[loading], levels.swe_mean_m_per_s[loading],
            levels.swe_sd_m_per_s[loading],
        )  # fmt: skip
    save_figure(wave_speed(readings, predicted=predicted), writer.file("swe_picture", "swe.png"))
    shown = [
        LevelMaps(int(levels.rows[k]), float(levels.force[k]), one, other or None)
        for k, one, other in zip(found.levels, found.maps, found.measured, strict=True)
    ]
    # the side of the patient to which the image's lateral axis, x of the model, points
    toward = side_of(patient_from_model(fitted)[:3, 0]) if "patient_from_model" in fitted.info else None
    picture = speed_maps(shown, toward=toward)
    save_figure(picture, writer.file("swe_maps_picture", "swe-maps.png"))
    _report(found, levels, writer)


def _predict(
    fitted: LimbModel, simulation: Simulation, levels: Levels, site: Site, writer: StageWriter
) -> Predicted:
    numbers, rows = simulated_rows(levels, simulation.probe_depth())
    width = probe_length(fitted)
    measured = tuple(_measured_map(site, levels, int(k), width, writer) for k in numbers)
    maps = level_maps(
        fitted, simulation, rows, density_kg_per_m3=site.density_kg_per_m3,
        pixels=[(each.lateral, each.depth) if each else None for each in measured],
    )  # fmt: skip
    force = np.array([simulation.probe_force()[row] if row != AT_REST else 0.0 for row in rows])
    return Predicted(numbers, force, tuple(maps), measured)


def simulated_rows(levels: Levels, depths: Array) -> tuple[IntArray, IntArray]:
    """Indices of the simulated loading levels, and of each one's time (AT_REST at first touch)."""
    numbers, rows = [], []
    for k in np.flatnonzero(levels.loading):
        nearest = int(np.abs(depths - levels.depth[k]).argmin())
        if levels.depth[k] <= LEAST_START:
            nearest = AT_REST
        elif abs(depths[nearest] - levels.depth[k]) > _SAME_DEPTH:
            continue
        numbers.append(int(k))
        rows.append(nearest)
    return np.array(numbers, dtype=np.int64), np.array(rows, dtype=np.int64)


def _measured_map(site: Site, levels: Levels, level: int, width: float, writer: StageWriter) -> SweMap | None:
    """The level's measured map if there is one; an unreadable map is omitted with a warning."""
    row = int(levels.rows[level])
    if site.swe_maps is None or not map_file(site.swe_maps, row).is_file():
        return None
    path = map_file(site.swe_maps, row)
    swe, problems = check_map(path)
    faults = errors_of([*problems, *(check_width(swe, width) if swe and len(swe) else ())])
    if swe is None or faults or not len(swe):
        what = faults[0].what if faults else "it has no pixels"
        writer.warnings.append(f"the shear-wave map {path.name} is not shown: {what}")
        return None
    writer.used(f"swe_map_level_{row}", path)
    for each in check_mean(swe, float(levels.swe_mean_m_per_s[level])):
        text = f"{path.name}: {each.what} ({each.fix})"
        if text not in writer.warnings:
            writer.warnings.append(text)
    return swe


def _write_speed_table(found: Predicted, levels: Levels, writer: StageWriter) -> None:
    k = found.levels
    columns: dict[str, Iterable[object]] = {
        "level": levels.rows[k], "force_n": levels.force[k], "depth_mm": levels.depth[k],
        "simulated_force_n": found.force,
        "measured_m_per_s": levels.swe_mean_m_per_s[k], "measured_sd_m_per_s": levels.swe_sd_m_per_s[k],
        "predicted_m_per_s": found.mean_m_per_s,
        "predicted_sd_m_per_s": [float(each.speed_m_per_s.std()) for each in found.maps],
        "pixels": [len(each) for each in found.maps],
    }  # fmt: skip
    write_table(writer.file("swe", "swe.csv"), columns)


def _report(found: Predicted, levels: Levels, writer: StageWriter) -> None:
    measured, mean = levels.swe_mean_m_per_s[found.levels], found.mean_m_per_s
    both = np.isfinite(measured)
    loaded = both & np.isfinite(found.mean_m_per_s) & (levels.depth[found.levels] > LEAST_START)
    gap = mean - measured
    facts: dict[str, object] = {
        "n_levels": len(found.levels),
        "n_measured_maps": sum(each is not None for each in found.measured),
        "mean_predicted_m_per_s": mean,
        "loaded_measured_m_per_s": measured[loaded],
        "loaded_predicted_m_per_s": mean[loaded],
        "rmse_m_per_s": float(np.sqrt(np.mean(gap[loaded] ** 2))) if loaded.any() else None,
    }
    writer.data["swe"] = facts
    text = f"shear-wave speed predicted: {mean[0]:.2f} to {mean[-1]:.2f} m/s"
    if loaded.any():
        last = int(np.flatnonzero(loaded)[-1])
        text += (
            f" (measured at the last level {measured[last]:.2f} m/s; root-mean-square difference under load "
            f"{facts['rmse_m_per_s']:.2f} m/s)"
        )
    writer.summary.append(text)
