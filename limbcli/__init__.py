"""Soft-tissue parameters of a residual limb from MRI, indentation and elastography.

Units inside the package: mm, N, MPa, s (mass in tonne). The public interface is imported from here:

    from limbcli import Case, segment, mesh, build_feb, fit, report

The module behind a name is imported on first use of the name, so that `import limbcli` itself is fast.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limbcli.files.kernel_folder import keep_kernels
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.api.cohorts import BatchResult as BatchResult
    from limbcli.api.cohorts import CaseResult as CaseResult
    from limbcli.api.cohorts import CohortResult as CohortResult
    from limbcli.api.cohorts import FailedStage as FailedStage
    from limbcli.api.cohorts import batch as batch
    from limbcli.api.cohorts import cohort as cohort
    from limbcli.api.diagnosis import DiagnosisResult as DiagnosisResult
    from limbcli.api.diagnosis import ReportResult as ReportResult
    from limbcli.api.diagnosis import diagnose as diagnose
    from limbcli.api.diagnosis import report as report
    from limbcli.api.fit_results import ElementComparison as ElementComparison
    from limbcli.api.fit_results import Estimate as Estimate
    from limbcli.api.fit_results import FitResult as FitResult
    from limbcli.api.fit_results import JointFitResult as JointFitResult
    from limbcli.api.fit_results import StatesFitResult as StatesFitResult
    from limbcli.api.fitting import compare_elements as compare_elements
    from limbcli.api.fitting import fit as fit
    from limbcli.api.fitting import fit_joint as fit_joint
    from limbcli.api.fitting import fit_states as fit_states
    from limbcli.api.geometry import Marker as Marker
    from limbcli.api.geometry import MeshResult as MeshResult
    from limbcli.api.geometry import MeshStudyResult as MeshStudyResult
    from limbcli.api.geometry import SegmentResult as SegmentResult
    from limbcli.api.geometry import mesh as mesh
    from limbcli.api.geometry import segment as segment
    from limbcli.api.making import MadeCase as MadeCase
    from limbcli.api.making import make_phantom as make_phantom
    from limbcli.api.making import synth as synth
    from limbcli.api.notebook import ShownProgress as ShownProgress
    from limbcli.api.simulation import BuildFebResult as BuildFebResult
    from limbcli.api.simulation import RunResult as RunResult
    from limbcli.api.simulation import build_feb as build_feb
    from limbcli.api.simulation import run as run
    from limbcli.api.simulation import run_feb as run_feb
    from limbcli.api.stage_result import Result as Result
    from limbcli.api.stage_result import SiteResults as SiteResults
    from limbcli.api.subjects import CheckResult as CheckResult
    from limbcli.api.subjects import MeasureResult as MeasureResult
    from limbcli.api.subjects import check as check
    from limbcli.api.subjects import measure as measure
    from limbcli.api.whole_limb import LimbResult as LimbResult
    from limbcli.api.whole_limb import PatchPressure as PatchPressure
    from limbcli.api.whole_limb import SocketResult as SocketResult
    from limbcli.api.whole_limb import limb as limb
    from limbcli.api.whole_limb import socket as socket
    from limbcli.case import Case as Case
    from limbcli.errors import CaseError as CaseError
    from limbcli.errors import FitError as FitError
    from limbcli.errors import LimbcliError as LimbcliError
    from limbcli.errors import MeasurementError as MeasurementError
    from limbcli.errors import MeshError as MeshError
    from limbcli.errors import SolveError as SolveError
    from limbcli.errors import ToolError as ToolError
    from limbcli.errors.problems import Problem as Problem
    from limbcli.feb.read import read_feb as read_feb
    from limbcli.feb.write import write_feb as write_feb
    from limbcli.model import LimbModel as LimbModel
    from limbcli.progress import Progress as Progress
    from limbcli.solvers.session import MustPoints as MustPoints
    from limbcli.solvers.session import ReferenceSession as ReferenceSession
    from limbcli.solvers.session import SessionResult as SessionResult
    from limbcli.solvers.session_options import StartFrom as StartFrom
    from limbcli.solvers.session_options import StopWhen as StopWhen
    from limbcli.solvers.solver import Simulation as Simulation

# Module of each public name; a test compares this list, and the signatures, with the documented interface.
_PUBLIC = {
    "api.stage_result": ("Result", "SiteResults"),
    "api.cohorts": ("BatchResult", "CaseResult", "CohortResult", "FailedStage", "batch", "cohort"),
    "api.diagnosis": ("DiagnosisResult", "ReportResult", "diagnose", "report"),
    "api.fit_results": ("ElementComparison", "Estimate", "FitResult", "JointFitResult", "StatesFitResult"),
    "api.fitting": ("compare_elements", "fit", "fit_joint", "fit_states"),
    "api.geometry": ("Marker", "MeshResult", "MeshStudyResult", "SegmentResult", "mesh", "segment"),
    "api.notebook": ("ShownProgress",),
    "api.simulation": ("BuildFebResult", "RunResult", "build_feb", "run", "run_feb"),
    "api.making": ("MadeCase", "make_phantom", "synth"),
    "api.whole_limb": ("LimbResult", "PatchPressure", "SocketResult", "limb", "socket"),
    "api.subjects": ("CheckResult", "MeasureResult", "check", "measure"),
    "case": ("Case",),
    "errors": (
        "CaseError", "FitError", "LimbcliError", "MeasurementError", "MeshError", "SolveError", "ToolError",
    ),
    "errors.problems": ("Problem",),
    "feb.read": ("read_feb",),
    "feb.write": ("write_feb",),
    "model": ("LimbModel",),
    "progress": ("Progress",),
    "solvers.solver": ("Simulation",),
    "solvers.session": ("MustPoints", "ReferenceSession", "SessionResult"),
    "solvers.session_options": ("StartFrom", "StopWhen"),
}  # fmt: skip
keep_kernels(Path(__file__).parent)  # before anything is compiled
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'limbcli' has no attribute {name!r}")
    found = getattr(import_module(f"limbcli.{_HOME[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
