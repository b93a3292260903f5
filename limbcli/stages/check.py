"""check: validate a case before any computation and report all problems at once.

The stages stop at the first input that they cannot use; `check` reads every file that can be
read, even if case.toml itself has errors.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from limbcli.case import CASE_FILE, Site, read_case
from limbcli.case.label_sources import read_label_sources
from limbcli.case.reading import CaseReading
from limbcli.case.socket import socket_of
from limbcli.case.toml_file import read_toml
from limbcli.errors import CaseError, LimbError, MeasurementError
from limbcli.errors.problems import Problem, errors_of, suggestion
from limbcli.measurement.elastography import check_maps, check_mean, check_width, map_file
from limbcli.measurement.indentation import check_levels, check_trace
from limbcli.measurement.levels import FEWEST_LOADING
from limbcli.progress import SILENT, Progress
from limbcli.site_model.cycle_words import cycle_lines
from limbcli.site_model.mesh_checks import SKIN_BONE_TOLERANCE, skin_bone_of_levels
from limbcli.site_model.site_levels import levels_of
from limbcli.site_model.site_states import state_problems
from limbcli.stages.check_geometry import geometry_findings
from limbcli.stages.check_instruments import instrument_problems, layer_lines, stated_layer_noise


@dataclass(frozen=True)
class CaseCheck:
    """What was checked, the problems found, and the lines to be shown."""

    case: Path
    looked_at: tuple[str, ...]
    problems: tuple[Problem, ...]
    shown: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0, or the exit code of the most severe family of problems (case before measurement)."""
        errors = errors_of(self.problems)
        if not errors:
            return 0
        in_case = any(each.family == "case" for each in errors)
        return CaseError.exit_code if in_case else MeasurementError.exit_code

    def to_json(self) -> dict[str, Any]:
        return {
            "case": str(self.case),
            "ok": self.exit_code == 0,
            "looked_at": list(self.looked_at),
            "problems": [vars(each) for each in self.problems],
            "shown": list(self.shown),
        }


def check(folder: Path, *, progress: Progress = SILENT) -> CaseCheck:
    """Validate a case folder completely; problems of the case are returned, never raised."""
    progress.event("stage", name="check")
    case, problems = read_case(folder, limb_alone=True)
    looked_at = [CASE_FILE]
    raw = _raw(folder)
    for label, path, reader in _readers(raw, folder):
        looked_at.append(label)
        problems += reader(path)
    read, found, on_labels = _read_labels(raw, folder)
    looked_at += read
    problems += found
    shown = on_labels
    if case is not None:
        problems += _contradictions(case, problems)
        reported = {each.what for each in problems}
        problems += [each for each in instrument_problems(case) if each.what not in reported]
        problems += state_problems(case)
        problems += [each for site in case.sites if site.states for each in _caught(partial(_plan, site))]
        found, on_geometry = geometry_findings(case, problems)
        problems += found
        more = [each for each in on_geometry if each not in on_labels]
        shown = [*on_labels, *layer_lines(case), *cycle_lines(case), *more]
    return CaseCheck(folder, tuple(looked_at), tuple(problems), tuple(shown))


Reader = Callable[[Path], list[Problem]]


def _raw(folder: Path) -> Mapping[str, Any]:
    try:
        return read_toml(folder / CASE_FILE)
    except (OSError, ValueError):
        return {}


def _readers(raw: Mapping[str, Any], folder: Path) -> list[tuple[str, Path, Reader]]:
    """Every existing file that case.toml names, with the function that checks it."""
    listed: list[tuple[object, Reader]] = []
    files = CaseReading.of(raw, folder)
    imaging = raw.get("imaging")
    if isinstance(imaging, dict):
        listed += [(imaging.get("mri"), _read_mri)]
        listed += [(imaging.get("fibres"), _read_fibres)]
        bones = imaging.get("bones")
        surfaces = [imaging.get("skin"), *(bones if isinstance(bones, list) else [])]
        listed += [(each, _read_surface) for each in surfaces]
    socket = raw.get("socket")
    if isinstance(socket, dict):
        listed += [(socket.get("surface"), _read_surface)]
    sites = raw.get("site")
    for site in sites if isinstance(sites, list) else []:
        if isinstance(site, dict):
            noise = stated_layer_noise(site)
            listed += [(site.get("levels"), _checked(check_levels, noise=noise))]
            states = site.get("state")
            several = [each for each in states if isinstance(each, dict)] if isinstance(states, list) else []
            listed += [(each.get("levels"), _checked(check_levels, noise=noise)) for each in several]
            listed += [(site.get("trace"), _checked(check_trace))]
            listed += [(site.get("swe_maps"), _read_maps)]
    return [
        (name, folder / name, reader)
        for name, reader in listed
        if isinstance(name, str) and files.may_use(name) and (folder / name).exists()
    ]


def _checked(check: Callable[..., tuple[object, list[Problem]]], **options: Any) -> Reader:
    """The problems that a check finds in a file; none in a folder."""
    return lambda path: check(path, **options)[1] if path.is_file() else []


def _read_maps(folder: Path) -> list[Problem]:
    return check_maps(folder)[1] if folder.is_dir() else []


def _read_mri(path: Path) -> list[Problem]:
    from limbcli.imaging.image_files import read_image
    from limbcli.imaging.volume import unplaced

    found: list[Problem] = []
    return _caught(lambda: found.extend(unplaced(read_image(path).volume, path))) + found


def _read_labels(raw: Mapping[str, Any], folder: Path) -> tuple[list[str], list[Problem], list[str]]:
    """The label maps read, their problems, and what each number and name in them is taken for."""
    imaging = raw.get("imaging")
    table = imaging.get("labels") if isinstance(imaging, dict) else None
    looked_at: list[str] = []
    problems: list[Problem] = []
    lines: list[str] = []
    for source in read_label_sources(table, CaseReading.of(raw, folder)):
        from limbcli.imaging.label_files import label_lines

        looked_at.append(os.path.relpath(source.path, folder))
        problems += _caught(lambda source=source: lines.extend(label_lines(source)))  # type: ignore[misc]
    return looked_at, problems, lines


def _read_fibres(path: Path) -> list[Problem]:
    from limbcli.imaging.fibre_map import read_fibre_map

    return _caught(lambda: read_fibre_map(path)) if path.is_file() else []


def _read_surface(path: Path) -> list[Problem]:
    from limbcli.imaging.surface import read_surface

    return _caught(lambda: read_surface(path))


def _plan(site: Site) -> object:
    from limbcli.fitting.state_plan import stretch_plan

    return stretch_plan(site)


def _caught(read: Callable[[], object]) -> list[Problem]:
    try:
        read()
    except LimbError as error:
        return [Problem(error.what, error.where, error.fix)]
    return []


def _contradictions(case: Any, known: Sequence[Problem]) -> list[Problem]:
    """Inconsistencies between files that are each valid, other than those known of single files."""
    from limbcli.meshing.probe import ProbeShape, check_shape

    problems = []
    probe = case.probe
    if probe.width > probe.length:
        problems.append(
            Problem(
                f"the probe is wider ({probe.width:g} mm) than long ({probe.length:g} mm)",
                str(case.file),
                "length_mm is the long side of the face, width_mm the short one",
            )
        )
    shape = ProbeShape(probe.length, probe.width, probe.edge_radius)
    problems += _caught(lambda: check_shape(shape, where=str(case.file)))
    problems += _shared_files(case) + _socket_names(case)
    for site in case.sites:
        problems += _unmeasured(site, case.folder)
        problems += _too_few(site) + _other_distance(site, str(case.file))
        problems += _missing_maps(site, probe.length, known)
        if site.noise.source == "assumed":
            problems.append(
                Problem(
                    f"the noise of site {site.name} is assumed, not measured",
                    str(case.file),
                    'repeat a level and state its standard deviation in [site.noise] with source = "repeats"',
                    severity="warning",
                )
            )
    return problems


def _socket_names(case: Any) -> list[Problem]:
    """Patches and landmarks of [socket] that no limb has; those that this limb lacks show in `limb`."""
    from limbcli.meshing.limb_parts import LANDMARKS, PATCHES

    socket = socket_of(case)
    if socket is None:
        return []
    named = [("patch", socket.rectifications, PATCHES), ("landmark", socket.landmarks, LANDMARKS)]
    return [
        Problem(f"[socket] names a {what} {name!r}", str(case.file), suggestion(name, known))
        for what, given, known in named for name in given if name not in known
    ]  # fmt: skip


def _shared_files(case: Any) -> list[Problem]:
    """Warn of measurement files that two sites name (a copied [[site]]); a joint fit counts them twice."""
    owner: dict[Path, str] = {}
    problems = []
    for site in case.sites:
        own = [each.levels for each in site.states] if site.states else [site.levels]
        for path in (*own, site.trace, site.swe_maps):
            first = owner.setdefault(path.resolve(), site.name) if path is not None else site.name
            if first != site.name:
                what = f"sites {first} and {site.name} use the same {path.name}"
                fix = (
                    "a measurement belongs to one site: give each site its own file, or it counts twice in "
                    "a joint fit"
                )
                problems.append(Problem(what, str(path), fix, severity="warning"))
    return problems


def _unmeasured(site: Site, folder: Path) -> list[Problem]:
    """Warn if levels.csv has yet to be made from the instruments' recordings."""
    if site.levels.is_file():
        return []
    command = f"limbcli measure {shlex.quote(str(folder))} --site {site.name} --write"
    return [
        Problem(
            f"site {site.name} has no {site.levels.name} yet",
            str(site.levels),
            f"`{command}` makes it from the recordings",
            severity="warning",
        )
    ]


def _too_few(site: Site) -> list[Problem]:
    """A problem if the fitted cycle has fewer levels beyond first touch than a two-parameter fit needs."""
    try:
        levels = levels_of(site) if site.levels.is_file() else None
    except LimbError:
        return []  # the file's own problems are reported
    n = FEWEST_LOADING if levels is None else int((levels.loading & (levels.depth > 0.0)).sum())
    if n >= FEWEST_LOADING:
        return []
    what = f"only {n} levels of loading are deeper than first touch"
    fix = f"`fit` needs at least {FEWEST_LOADING} with depth_mm above 0: measure more force levels"
    return [Problem(what, str(site.levels), fix, family="measurement")]


def _other_distance(site: Site, file: str) -> list[Problem]:
    """Warn if the site's skin_bone_mm differs from the distance read at level 0."""
    seen = skin_bone_of_levels(site)
    if site.skin_bone is None or seen is None or abs(site.skin_bone / seen - 1) <= SKIN_BONE_TOLERANCE:
        return []
    what = (
        f"skin_bone_mm of site {site.name} is {site.skin_bone:g} mm, but level 0 of its levels gives "
        f"{seen:.1f}"
    )
    return [Problem(what, file, "correct one of the two, or remove the site's", severity="warning")]


def _missing_maps(site: Any, probe_length: float, known: Sequence[Problem]) -> list[Problem]:
    """Shear-wave maps that are missing for a row of levels.csv, too wide, or contradict levels.csv."""
    levels, _ = check_levels(site.levels)
    if site.swe_maps is None or levels is None:
        return []
    seen = {str(each) for each in known}
    maps, problems = check_maps(site.swe_maps, len(levels))
    found = [each for each in problems if str(each) not in seen]
    for swe in maps:
        found += check_width(swe, probe_length)
        row = next((k for k in range(len(levels)) if map_file(site.swe_maps, k) == swe.path), None)
        found += check_mean(swe, float(levels.swe_mean_m_per_s[row])) if row is not None else []
    return found
