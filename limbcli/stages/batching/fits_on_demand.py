"""Fits made on demand, which a batch keeps up to date once they have been made.

`fit-joint` and `fit-elements` are not part of every batch. If the output folder contains one, a
batch treats it like any stage: it is up to date while its inputs are unchanged, and is otherwise
made again with the same options.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.files.atomic import sha256
from limbcli.fitting.options import FitOptions
from limbcli.progress import SILENT, Progress
from limbcli.provenance.requested_options import options_of
from limbcli.provenance.staleness import Chain
from limbcli.results import ERROR_FILE, StageResult, result_if_there, stage_folder
from limbcli.version import __version__


@dataclass(frozen=True, eq=False)
class FitOnDemand:
    """An existing result: its sites, whether its inputs are unchanged, and a function that makes it again."""

    stage: str
    site: str | None
    sites: tuple[str, ...]
    is_current: bool
    redo: Callable[[], object]


def extras(case: Case, out: Path, *, progress: Progress = SILENT) -> Iterator[FitOnDemand]:
    """The fits on demand found in `out`; an unreadable one is skipped (the report shows it)."""
    names = tuple(site.name for site in case.sites)
    joint = result_if_there(out, "fit-joint")
    sites = () if joint is None else tuple(each for each in joint.data.get("sites", ()) if each in names)
    if joint is not None and sites:
        from limbcli.stages.fit_joint import fit_joint

        laws = {"law": str(joint.data.get("law", "ogden")), "compare_laws": bool(joint.data.get("laws"))}
        options = options_of(FitOptions, {**_requested(joint), **laws})
        redo = partial(fit_joint, case, out=out, sites=list(sites), options=options, progress=progress)
        yield FitOnDemand("fit-joint", None, sites, _is_current(case, out, joint, sites), redo)
    for name in names:
        compared = result_if_there(out, "fit-elements", site=name)
        if compared is not None:
            from limbcli.stages.fit_elements import compare_elements

            options = options_of(FitOptions, _requested(compared))
            again = partial(compare_elements, case, out=out, sites=[name], options=options, progress=progress)
            current = _is_current(case, out, compared, (name,))
            yield FitOnDemand("fit-elements", name, (name,), current, again)


def _requested(found: StageResult) -> Mapping[str, Any]:
    """A fit's options that differ from the defaults; empty if their record is damaged."""
    given = found.data.get("asked")
    return given if isinstance(given, Mapping) else {}


def made_by_hand(case: Case, out: Path, site: str, *, solver: str) -> bool:
    """Whether a site's fit is of the current model and measurement, this version and this solver."""
    found = result_if_there(out, "fit", site=site)
    if found is None or (stage_folder(out, "fit", site) / ERROR_FILE).exists():
        return False
    same_solver = solver in ("auto", found.data.get("solver"))
    same_version = found.provenance.get("limbcli") == __version__
    study = stage_folder(out, "mesh-study", site) / "mesh-study.json"
    used = "mesh-study" in found.provenance.get("inputs_sha256", {})
    requested = _requested(found)
    unknown = study.is_file() and not used and "gain_deviation" not in requested
    current = _is_current(case, out, found, (site,))
    return same_solver and same_version and current and not unknown


def _is_current(case: Case, out: Path, found: StageResult, sites: tuple[str, ...]) -> bool:
    """Whether everything from which it was made is unchanged."""
    if Chain(case, out).broken(found) is not None:
        return False
    used = found.provenance.get("inputs_sha256", {})
    for name in sites:
        study = stage_folder(out, "mesh-study", name) / "mesh-study.json"
        hashes = {used[label] for label in (f"{name}/mesh-study", "mesh-study") if label in used}
        if hashes and (not study.is_file() or hashes != {sha256(study)}):
            return False
    return set(sites) == set(found.data.get("sites", sites))
