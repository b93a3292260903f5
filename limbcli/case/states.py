"""States in case.toml: one site measured at several stretches of the tissue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.files import CaseFiles
from limbcli.case.parts import Stretch, StretchState
from limbcli.errors.problems import Problem

_NOT_BESIDE = ("trace", "swe_maps", "load_cell", "b_mode", "swe_images")
_UNLOADED = ("unloaded_stretch_along", "unloaded_stretch_around")


def site_schema(table: object) -> Mapping[str, schema.Key]:
    """The keys of a [[site]]; with states, `levels` belongs to the states and is not required.

    >>> site_schema({"state": []})["levels"].required, site_schema({})["levels"].required
    (False, True)
    """
    if not (isinstance(table, dict) and "state" in table):
        return schema.SITE
    return {**schema.SITE, "levels": schema.Key("file", schema.text)}


def read_states(
    values: Mapping[str, Any], files: CaseFiles, label: str
) -> tuple[tuple[StretchState, ...], Stretch, list[Problem]]:
    """The states of a site, and the stretches at which its tissue is known to be unloaded.

    values : of the site's table, with defaults filled in
    """
    file = str(files.folder / "case.toml")
    known = Stretch(*(None if values[key] is None else float(values[key]) for key in _UNLOADED))
    tables = values["state"]
    if tables is None:
        given = [key for key in _UNLOADED if values[key] is not None]
        fix = "add [[site.state]] tables, or remove it"
        return (), known, [Problem(f"{label} has {key} but no states", file, fix) for key in given]
    problems = _beside(values, label, file)
    states: list[StretchState] = []
    for k, table in enumerate(tables, 1):
        state, found = _read_state(table, files, f"{label} state {k}")
        problems += found
        if state is not None:
            states.append(state)
    return tuple(states), known, problems + _alone(tables, label, file) + _twice(states, label, file)


def _read_state(table: object, files: CaseFiles, label: str) -> tuple[StretchState | None, list[Problem]]:
    file = str(files.folder / "case.toml")
    values, problems = schema.check_table(table, schema.STATE, name=label, file=file)
    if not values:
        return None, problems
    label = f"{label} ({values['name']})" if values.get("name") else label
    path, found = files.existing(values.get("levels"), f"{label}: levels", is_folder=False)
    problems += found
    if problems or path is None:
        return None, problems
    along, around = (values[f"stretch_{way}"] for way in ("along", "around"))
    return StretchState(values["name"], Stretch(_number(along), _number(around)), path), problems


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _beside(values: Mapping[str, Any], label: str, file: str) -> list[Problem]:
    problems = []
    if values["levels"] is not None:
        what = f"{label} has its own levels as well as [[site.state]]"
        problems.append(Problem(what, file, "move that file to the state it was measured in"))
    for key in _NOT_BESIDE:
        if values[key] is not None:
            what = f"{label} has {key} together with [[site.state]], which is not supported"
            fix = "create each state's levels.csv in a separate case (limbcli measure), and enter it here"
            problems.append(Problem(what, file, fix))
    return problems


def _alone(tables: list[object], label: str, file: str) -> list[Problem]:
    if len(tables) >= 2:
        return []
    fix = "add the states it is to be compared with, or give the site `levels` instead of a state"
    return [
        Problem(f"{label} has only one state; the unloaded state is found by comparing states", file, fix)
    ]


def _twice(states: list[StretchState], label: str, file: str) -> list[Problem]:
    problems = []
    names, paths = [each.name for each in states], [each.levels.resolve() for each in states]
    keys = [schema.folder_key(each) for each in names]
    for name in sorted({each for each, key in zip(names, keys, strict=True) if keys.count(key) > 1}):
        problems.append(Problem(f"{label} has two states named {name!r}", file, "give each its own name"))
    for path in sorted({each for each in paths if paths.count(each) > 1}):
        what = f"{label} has two states with the levels of {path.name}"
        problems.append(Problem(what, file, "give each state its own file"))
    return problems
