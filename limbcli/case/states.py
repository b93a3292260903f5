"""States in case.toml: one site measured at several stretches of the tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.parts import Stretch, StretchState
from limbcli.case.reading import CaseReading

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
    values: Mapping[str, Any], reading: CaseReading, label: str
) -> tuple[tuple[StretchState, ...], Stretch]:
    """The states of a site, and the stretches at which its tissue is known to be unloaded.

    values : of the site's table, with defaults filled in
    """
    known = Stretch(*(None if values[key] is None else float(values[key]) for key in _UNLOADED))
    tables = values["state"]
    if tables is None:
        for key in (each for each in _UNLOADED if values[each] is not None):
            reading.wrong(f"{label} has {key} but no states", "add [[site.state]] tables, or remove it")
        return (), known
    _check_beside(values, label, reading)
    read = [_read_state(table, reading, f"{label} state {k}") for k, table in enumerate(tables, 1)]
    states = tuple(each for each in read if each is not None)
    if len(tables) < 2:
        what = f"{label} has only one state; the unloaded state is found by comparing states"
        fix = "add the states it is to be compared with, or give the site `levels` instead of a state"
        reading.wrong(what, fix)
    _check_repeats(states, label, reading)
    return states, known


def _read_state(table: object, reading: CaseReading, label: str) -> StretchState | None:
    own = reading.part()
    values = own.table(table, schema.STATE, label)
    if not values:
        return None
    label = f"{label} ({values['name']})" if values.get("name") else label
    path = own.existing(values.get("levels"), f"{label}: levels", is_folder=False)
    if own.problems or path is None:
        return None
    along, around = (values[f"stretch_{way}"] for way in ("along", "around"))
    return StretchState(values["name"], Stretch(_number(along), _number(around)), path)


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _check_beside(values: Mapping[str, Any], label: str, reading: CaseReading) -> None:
    """A site with states has no measurement of its own."""
    if values["levels"] is not None:
        what = f"{label} has its own levels as well as [[site.state]]"
        reading.wrong(what, "move that file to the state it was measured in")
    for key in (each for each in _NOT_BESIDE if values[each] is not None):
        what = f"{label} has {key} together with [[site.state]], which is not supported"
        fix = "create each state's levels.csv in a separate case (limbcli measure), and enter it here"
        reading.wrong(what, fix)


def _check_repeats(states: Sequence[StretchState], label: str, reading: CaseReading) -> None:
    """Every state has its own name and its own levels."""
    names, paths = [each.name for each in states], [each.levels.resolve() for each in states]
    keys = [schema.folder_key(each) for each in names]
    for name in sorted({each for each, key in zip(names, keys, strict=True) if keys.count(key) > 1}):
        reading.wrong(f"{label} has two states named {name!r}", "give each its own name")
    for path in sorted({each for each in paths if paths.count(each) > 1}):
        what = f"{label} has two states with the levels of {path.name}"
        reading.wrong(what, "give each state its own file")
