"""The simulated curves that `fit` left in curves.csv."""

from __future__ import annotations

from limbcli.reporting.figures.force_depth import SimulatedCurve
from limbcli.results import StageResult


def read_curves(result: StageResult) -> tuple[SimulatedCurve, ...]:
    return ()
