"""The unit that an instrument's file states for a column, and its factor to our units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from limbcli.errors import MeasurementError
from limbcli.numbers.units import (
    ACCELERATION_UNITS_IN_G,
    FORCE_UNITS_IN_N,
    LENGTH_UNITS_IN_MM,
    TIME_UNITS_IN_S,
    unit_named,
)

# our columns: name in words, units and their sizes, the key of case.toml that states one, and what is assumed
_OF = {
    "time": (TIME_UNITS_IN_S, "time_unit", "s"),
    "force": (FORCE_UNITS_IN_N, "force_unit", "N"),
    "depth": (LENGTH_UNITS_IN_MM, "length_unit", "mm"),
    "probe_travel": (LENGTH_UNITS_IN_MM, "length_unit", "mm"),
    **{f"accel_{axis}": (ACCELERATION_UNITS_IN_G, "", "g") for axis in "xyz"},
}
# what testing machines and loggers call them, of columns that state a unit or hold times of day
_ALSO_CALLED = {
    "time": "elapsed_time test_time running_time timestamp time_stamp datetime date_time date/time zeit "
    "pr\u00fcfzeit temps tiempo tempo tijd",
    "force": "load axial_force axial_load standard_force compressive_force compressive_load kraft "
    "standardkraft fuerza forza kracht",
}
_IN_BRACKETS = re.compile(r"[\(\[\{]\s*([^()\[\]{}]*?)\s*[\)\]\}]")
_AT_THE_END = re.compile(r"^(.+?)\s*(?:[/,]|_|\bin\b)\s*([^\s/,_]+)$", re.IGNORECASE)


def quantity(name: str) -> str:
    """
    >>> quantity("probe_travel_mm")
    'probe_travel'
    """
    return name.rpartition("_")[0]


def stated_unit(title: str, name: str) -> tuple[str, str]:
    """A column's title without its unit, and the unit as it is written ("" if there is none).

    name : the column that it is for us

    >>> stated_unit("Time (ms)", "time_s"), stated_unit("Force [V]", "force_n")
    (('Time', 'ms'), ('Force', 'V'))
    >>> stated_unit("Depth, cm", "depth_mm")
    ('Depth', 'cm')
    >>> stated_unit("force_kgf", "force_n"), stated_unit("load cell_2", "force_n")
    (('force', 'kgf'), ('load cell_2', ''))
    """
    units = _OF[quantity(name)][0]
    brackets = list(_IN_BRACKETS.finditer(title))
    known = [each for each in brackets if unit_named(each[1], units)]
    for each in (known or brackets)[-1:]:
        return " ".join((title[: each.start()] + title[each.end() :]).split()), each[1]
    end = _AT_THE_END.match(title)
    if end is not None and unit_named(end[2], units):
        return end[1], end[2]
    return title, ""


def matches(title: str, name: str, *, other_words: bool = False) -> bool:
    """Whether a title is that of one of our columns in a unit that it states: "Time (ms)" for `time_s`.

    other_words : see `is_called`

    >>> matches("Time (ms)", "time_s"), matches("Probe travel [cm]", "probe_travel_mm")
    (True, True)
    >>> matches("Time", "time_s")
    False
    """
    bare, unit = stated_unit(title, name)
    return bool(unit) and is_called(bare, name, other_words=other_words)


def is_called(title: str, name: str, *, other_words: bool = False) -> bool:
    """Whether a title without a unit is that of one of our columns: "Time" for `time_s`.

    other_words : whether by what testing machines call it, such as "Load" for `force_n`
    """
    word = "_".join(title.lower().split())
    return word in _ALSO_CALLED.get(quantity(name), "").split() if other_words else word == quantity(name)


def is_unit(word: str, name: str) -> bool:
    """Whether a word is a unit of one of our columns.

    >>> is_unit("msec", "time_s"), is_unit("0.5", "time_s")
    (True, False)
    """
    return unit_named(word, _OF[quantity(name)][0]) is not None


def stated_word(title: str, name: str, label: str, given: Mapping[str, str | None]) -> str | None:
    """The unit of a column that the file states, where case.toml states none; None without one.

    Our own name, as in `trace.csv`, states nothing: its numbers may be in the unit that case.toml gives.
    """
    return None if given.get(_OF[quantity(name)][1]) else _stated(title, name, label)[1]


def _stated(title: str, name: str, label: str) -> tuple[str, str | None]:
    """The unit of a column as the file writes it, and as we know it (None if we do not).

    A label "g" apart from the title is not taken for a force: in LabVIEW's files it is an acceleration.
    """
    word = label or ("" if title == name else stated_unit(title, name)[1])
    if quantity(name) == "force" and label.strip() == "g":
        return word, None
    return word, unit_named(word, _OF[quantity(name)][0])


def factor(title: str, name: str, label: str, given: Mapping[str, str | None], path: Path) -> float:
    """From a column's numbers to our unit.

    label : the unit that another line of the file states for it, or ""
    given : units by key of case.toml (`time_unit`, ...); None: as the file states it, else ours

    Raises MeasurementError if the file states a unit that contradicts case.toml's, or that is none of this
    quantity while case.toml states none.
    """
    units, key, ours = _OF[quantity(name)]
    (word, stated), asked = _stated(title, name, label), given.get(key)
    if word and stated is None and asked is None and key:
        raise MeasurementError(
            f"the record states the unit {word[:20]!r} for {title[:40]!r}, which is none of "
            f"{', '.join(units)}",
            where=str(path),
            fix=f'convert its numbers; if the word is wrong, state their unit: {key} = "{ours}" in '
            "[site.load_cell]",
        )
    if stated and asked and stated != asked:
        raise MeasurementError(
            f"the record states the unit {word!r} for {title[:40]!r}, but case.toml states {key} = {asked!r}",
            where=str(path),
            fix=f"remove {key} from [site.load_cell], or correct it",
        )
    return units[asked or stated or ours]
