"""The simulated state of a site, read from a stage's model and records for the report."""

from __future__ import annotations

from limbcli.reporting.figures.convergence import Residuals
from limbcli.reporting.figures.deformed import DeformedState
from limbcli.results import StageResult


def read_deformed(result: StageResult, mesh: StageResult | None) -> DeformedState | None:
    return None


def read_residuals(result: StageResult) -> Residuals | None:
    return None
