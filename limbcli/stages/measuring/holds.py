"""measure: detect holds in the load cell's record: forces, cycles and phases, and warnings about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import Problem
from limbcli.measurement.holds import Hold, cycles_of_holds, find_holds, missing_levels, without_probe_weight
from limbcli.measurement.indentation import check_values
from limbcli.measurement.load_cell_record import RecordingFormat, read_recording
from limbcli.measurement.trace import Trace
from limbcli.results import StageWriter

_FEW_LOST = 0.01  # share of samples without a force above which a warning is given
_SMALL_FORCE = 4.0  # N, largest force of an indentation below which the unit is questioned
_FEWEST_LEVELS = 3
_ONE_LEVEL = 0.5  # fraction of the protocol's step; holds closer than that may be one level
_TURN = 0.5  # fraction of the protocol's step by which the force must reverse to start a new phase

Columns = dict[str, Sequence[Any]]


def force_columns(table: Mapping[str, Any], writer: StageWriter) -> Columns:
    """Columns of levels.csv by name, one row per hold; cycle and phase if there was unloading.

    table : [site.load_cell]

    Raises MeasurementError if the record cannot be read, or contains no hold.
    """
    from limbcli.measurement.instrument_pictures import draw_holds

    trace, holds = holds_of(table)
    draw_holds(trace, holds, writer.file("holds_picture", "holds.png"))
    step = float(table["step_n"])
    columns = columns_of(holds, step)
    phase = columns.get("phase", ["load"] * len(holds))
    _report_holds(holds, phase, trace, step, writer)
    if "cycle" in columns:
        last = writer.data["cycles"] = columns["cycle"][-1]
        n_unloading = list(phase).count("unload")
        writer.summary.append(
            f"{last} cycle{'s' if last > 1 else ''} found, {n_unloading} holds during unloading"
        )
    return columns


def columns_of(holds: Sequence[Hold], step: float) -> Columns:
    """Columns of levels.csv by name; step : the protocol's force step, N."""
    cycle, phase = cycles_of_holds([each.force for each in holds], turn=_TURN * step)
    columns: Columns = {
        "force_n": [each.force for each in holds],
        "hold_s": [each.duration_s for each in holds],
    }
    if "unload" in phase or cycle[-1] > 1:
        columns |= {"cycle": cycle, "phase": phase}
    if all(each.depth is not None for each in holds):
        first = holds[0].depth or 0.0
        columns["depth_mm"] = [(each.depth or 0.0) - first for each in holds]
    if any(each.probe_travel is not None for each in holds):
        travel = [each.probe_travel for each in holds]
        columns["probe_travel_mm"] = [np.nan if each is None else each for each in travel]
    return columns


def column_problems(columns: Mapping[str, Sequence[Any]], *, site: str, place: Path) -> list[Problem]:
    """Impossible values, or too few levels, in columns of levels.csv read from the instruments."""
    numbers = {name: values for name, values in columns.items() if name != "phase"}
    found = check_values(numbers, place)
    n = len(next(iter(columns.values())))
    if not found and n < _FEWEST_LEVELS:
        what = "there is only one level" if n == 1 else f"there are only {n} levels"
        fix = (
            "measure in steps of about 2 N; if holds were missed, change hold_s or hold_tolerance_n; "
            f"forces go up to {max(columns.get('force_n', [np.nan])):.3g} N: if that is another unit, "
            "state it (force_unit)"
        )
        found.append(Problem(what, f"site {site}", fix, family="measurement"))
    return found


def holds_of(table: Mapping[str, Any]) -> tuple[Trace, list[Hold]]:
    """The record, with the probe's weight subtracted, and its holds. Raises as `force_columns`."""
    path: Path = table["path"]
    trace = read_recording(
        path,
        RecordingFormat(
            columns=table["columns"], time_unit=table["time_unit"], force_unit=table["force_unit"],
            length_unit=table["length_unit"], separator=table["separator"], decimal=table["decimal"],
        ),
    )  # fmt: skip
    if table["tare_s"] is not None:
        tare = (float(table["tare_s"][0]), float(table["tare_s"][1]))
        mass, axis = float(table["probe_mass_kg"]), table["axis"]
        trace = without_probe_weight(trace, probe_mass_kg=mass, axis=axis, tare_s=tare)
    pressed = trace if table["tare_s"] is None else trace.since(float(table["tare_s"][1]))
    left = float(np.ptp(pressed.time)) if len(pressed.time) else 0.0
    if table["tare_s"] is not None and left < float(table["hold_s"]):
        raise MeasurementError(
            f"the record ends {left:.3g} s after tare_s: holds are searched for after the tare",
            where=str(path),
            fix="state as tare_s an interval in air before first touch, in seconds of the record's time",
        )
    return trace, find_holds(
        pressed, tolerance=float(table["hold_tolerance_n"]), duration_s=float(table["hold_s"])
    )


def _report_holds(
    holds: Sequence[Hold], phase: Sequence[str], trace: Trace, step: float, writer: StageWriter
) -> None:
    writer.data["holds"] = [vars(each) for each in holds]
    writer.summary.extend([trace.converted] if trace.converted else [])
    noise = float(np.median([each.force_sd for each in holds]))
    error = float(np.max([each.force_se for each in holds]))
    writer.summary.append(
        f"{len(holds)} holds, {min(h.duration_s for h in holds):.0f} s or longer; "
        f"sample noise {noise:.3f} N, error of a mean at most {error:.3f} N"
    )
    for k, hold in enumerate(holds):
        where = f"hold {k} ({hold.force:.2f} N, {hold.start_s:.0f} to {hold.end_s:.0f} s)"
        if hold.creeping:
            drift = f"{1000 * hold.drift_n_per_s:.1f} mN/s"
            if hold.depth_drift_mm_per_s is not None:
                drift += f", {1000 * hold.depth_drift_mm_per_s:.1f} um/s"
            writer.warnings.append(f"{where}: creep continues at its end ({drift})")
        turning = k > 0 and phase[k - 1] == "unload"  # the minimum between two cycles
        if phase[k] == "load" and hold.overshoot > max(0.5, 5 * noise) and not turning:
            writer.warnings.append(f"{where}: the force overshot by {hold.overshoot:.2f} N before it")
        if hold.n_dropouts:
            gaps = "1 gap" if hold.n_dropouts == 1 else f"{hold.n_dropouts} gaps"
            writer.warnings.append(f"{where}: {gaps} in the record")
        if hold.n_spikes:
            one = hold.n_spikes == 1
            spikes = "1 sample is a spike and was" if one else f"{hold.n_spikes} samples are spikes and were"
            writer.warnings.append(f"{where}: {spikes} left out")
    if holds[0].force > 0.5 * step:
        writer.warnings.append(
            f"the first hold is at {holds[0].force:.2f} N: depths count from there, not from first touch; "
            "hold at about 0 N first, for hold_s"
        )
    writer.warnings.extend(found_twice(holds, step))
    # warn of samples without a force, and of forces so small that they may be in another unit
    lost = int((~np.isfinite(trace.force)).sum())
    if lost > _FEW_LOST * len(trace.force):
        writer.warnings.append(f"{lost} of {len(trace.force)} samples of the record contain no force")
    largest = max(each.force for each in holds)
    if largest < _SMALL_FORCE:
        writer.warnings.append(
            f"the largest hold is at {largest:.2f} N: is the record in kgf, or in volts? (force_unit)"
        )
    for force in missing_levels(list(holds), step=step):
        writer.warnings.append(f"there is no hold at {force:g} N (steps of {step:g} N)")


def found_twice(holds: Sequence[Hold], step: float) -> list[str]:
    """Warnings of consecutive holds of similar force, probably one hold that a drifting force has split.

    step : the protocol's force step, N
    """
    found = []
    for k, (one, other) in enumerate(pairwise(holds)):
        if abs(other.force - one.force) < _ONE_LEVEL * step:
            found.append(
                f"holds {k} and {k + 1} ({one.force:.2f} and {other.force:.2f} N, before and after "
                f"{other.start_s:.0f} s) are closer than half a step of {step:g} N: one level counted "
                "twice, unless it was held twice; raise hold_s or hold_tolerance_n until they are one"
            )
    return found
