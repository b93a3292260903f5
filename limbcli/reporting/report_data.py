"""All data of one report page, collected by the report stage."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path

from limbcli.case import Case
from limbcli.measurement.regression import Line
from limbcli.reporting.figures.convergence import Residuals
from limbcli.reporting.figures.deformed import DeformedState
from limbcli.reporting.figures.force_depth import MeasuredCurve
from limbcli.reporting.figures.hysteresis_loops import Loop
from limbcli.reporting.figures.limb_views import LimbPlace
from limbcli.reporting.figures.wave_speed import SpeedReadings
from limbcli.reporting.outcome import Outcomes


@dataclass(frozen=True, eq=False)
class CycleMaterial:
    """Loading cycles of a record, with remarks on them.

    settled : whether the last loading repeats the one before it within noise
    contradiction : a sentence if later cycles contradict the one that was fitted
    """

    loops: tuple[Loop, ...]
    sentences: tuple[str, ...]
    settled: bool
    contradiction: str = ""


@dataclass(frozen=True, eq=False)
class SiteMaterial:
    """Measurement of one site, and the data that are read by other packages.

    If an item is None, the corresponding `why_*` gives the reason, in words for the page; that of `deformed`
    is empty if the model has not been run.
    """

    name: str
    place: str
    _: KW_ONLY
    measured: MeasuredCurve | None = None
    why_no_levels: str = ""
    speeds: SpeedReadings | None = None
    against_force: Line | None = None
    against_depth: Line | None = None
    why_no_line: str = ""
    deformed: DeformedState | None = None
    deformed_source: str = ""
    why_not_deformed: str = ""
    residuals: Residuals | None = None
    warnings: tuple[str, ...] = ()
    cycles: CycleMaterial | None = None
    on_limb: LimbPlace | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportData:
    case: Case
    case_name: str
    out: Path
    outcomes: Outcomes
    sites: tuple[SiteMaterial, ...]
    notices: tuple[str, ...] = ()
