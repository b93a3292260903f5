"""The report of `fit` on an assumed geometry: every variation, and the intervals with and without it."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.fitting.geometry import GeometryUncertainty
from limbcli.fitting.table import NAMES, Identified, inside
from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import at_depths, ends, shifts, total_share
from limbcli.inference.two_step_fit import sensitivities
from limbcli.numbers.significant_digits import short
from limbcli.results import StageWriter


def write_geometry(
    found: Identified, uncertainty: GeometryUncertainty, of_noise: Intervals | None, writer: StageWriter
) -> None:
    """Write `geometry_uncertainty` of fit.json, and a line of the summary.

    of_noise : intervals due to the measurement's noise alone; None if none were computed
    """
    rows = _rows(found, uncertainty)
    share = total_share(list(uncertainty.modes))
    reported: dict[str, Any] = {
        "words": uncertainty.words,
        "gain_fraction": share,
        "variations": rows,
        "n_solves": uncertainty.n_solves,
        "seconds": uncertainty.seconds,
        "interval_95_noise": ends(of_noise) if of_noise is not None else {},
        "interval_95": ends(found.intervals[-1]) if found.intervals else {},
        "standard_error_fraction": _deviations(rows, uncertainty),
    }
    writer.data["geometry_uncertainty"] = reported
    if uncertainty.words not in writer.warnings:
        writer.warnings.insert(0, uncertainty.words)
    writer.summary.append(
        f"the assumed geometry contributes a force uncertainty of {short(100 * share, 2)} % (one standard "
        f"deviation, {len(uncertainty.done)} shapes)"
    )


def _rows(found: Identified, uncertainty: GeometryUncertainty) -> list[dict[str, Any]]:
    step = found.steps[-1]
    answer = sensitivities(found, step.theta)
    assert answer.jacobian is not None
    free = inside(step)
    depth = found.data.depth[found.data.loaded]
    moved = np.full((len(uncertainty.done), len(NAMES)), np.nan)
    if free:
        change = np.array([each.known for each in uncertainty.done])
        newtons = answer.values[:, None] * at_depths(change, found.knots, depth)
        moved[:, free] = shifts(answer.jacobian[:, free], newtons)
    return [
        {
            "kind": each.variation.kind, "words": each.variation.words, "part": each.part,
            "weight": weight, "force_change_fraction": np.expm1(each.known),
            "log_shift": dict(zip(NAMES, row, strict=True)),
        }
        for each, weight, row in zip(uncertainty.done, uncertainty.weights, moved, strict=True)
    ]  # fmt: skip


def _deviations(rows: list[dict[str, Any]], uncertainty: GeometryUncertainty) -> dict[str, float]:
    """Standard deviations of ln f_kappa and ln m due to the geometry alone."""
    weights = uncertainty.weights
    return {
        name: float(np.sqrt(weights @ np.square([each["log_shift"][name] for each in rows])))
        for name in NAMES
    }
