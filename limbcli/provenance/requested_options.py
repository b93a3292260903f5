"""The options with which a stage was called, so that a batch can repeat the call.

A stage stores options that differ from its defaults as `asked` in its JSON. Options of a manual call
are used by every later batch, until the stage is called by hand without them or the batch is run with
`--defaults`.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from limbcli.results import plain

Requested = Mapping[str, Any]

_SPOKEN = {
    "seeds": "--seed", "smooth": "--smooth", "threshold": "--threshold", "limb": "--limb",
    "element": "--element", "size": "--size-mm", "far_size": "--far-size-mm", "margin": "--margin-mm",
    "skin_layer": "--skin-mm", "cut": "--cut-mm",
    "site_size": "--site-size-mm", "fat_layer": "--fat-mm", "place": "--at",
    "c_kpa": "--c-kpa", "f_kappa": "--f-kappa", "m": "--m", "layers": "--layer", "templates": "--templates",
    "time_limit_s": "--time-limit-s", "vtu": "--vtu", "c_deviation": "--c-deviation-fraction",
    "stiffness_map": "--stiffness-map", "tolerance": "--tolerance", "max_iterations": "--max-iterations",
    "gain_deviation": "--gain-deviation-fraction",
}  # fmt: skip


_PATHS = ("templates", "effect_file")


def requested_of(given: Requested, usual: Requested | None = None) -> dict[str, Any]:
    """Plain values of the options that differ from the defaults `usual` (None for those not listed there).

    >>> requested_of({"size": None, "margin": 30.0, "smooth": 0.7}, {"smooth": 0.7})
    {'margin': 30.0}
    """
    usual = usual or {}
    plainly = {
        key: str(value.resolve()) if isinstance(value, Path) else value for key, value in given.items()
    }
    return {key: plain(value) for key, value in plainly.items() if value != usual.get(key)}


def requested_by_options(options: Any) -> dict[str, Any]:
    """The same for a frozen dataclass of options whose fields have defaults."""
    return requested_of(vars(options), vars(type(options)()))


def options_of(kind: type, requested: Requested) -> Any:
    """An options dataclass with the requested values; unknown keys are ignored."""
    names = {each.name for each in fields(kind)}
    known = {key: value for key, value in requested.items() if key in names}
    known |= {key: tuple(known[key]) for key in ("effects", "draws", "seeds", "place") if key in known}
    paths = {key: Path(known[key]) for key in _PATHS if known.get(key) is not None}
    return kind(**{**known, **paths})


def in_words(requested: Requested) -> str:
    """The options as typed on the command line.

    >>> in_words({"stiffness_map": True, "fat_layer": 6.0, "intervals": False, "place": [90.0, 120.0]})
    '--stiffness-map --fat-mm 6 --no-intervals --at 90 120'
    >>> in_words({"effects": ["skin-layer", "tilt"], "measured": {"tare_n": 0.4}})
    '--effects skin-layer --effects tilt --measured tare_n=0.4'
    """
    return " ".join(_spoken(key, value) for key, value in requested.items())


def _spoken(key: str, value: Any) -> str:
    name = _SPOKEN.get(key, "--" + key.replace("_", "-"))
    if value is True:
        return name
    if value is False:
        return name.replace("--", "--no-", 1)
    if key == "seeds":
        return " ".join(f"{name} {kind}={','.join(f'{x:g}' for x in place)}" for kind, place in value)
    if key == "layers":
        laws = ("{}:{}".format(k, ",".join(f"{a}={b}" for a, b in law.items())) for k, law in value.items())
        return " ".join(f"{name} {law}" for law in laws)
    if key == "effects":
        return " ".join(f"{name} {shlex.quote(each)}" for each in value)
    if key == "measured":
        return " ".join(f"{name} {each}={number:g}" for each, number in value.items())
    several = value if isinstance(value, list) else [value]
    return " ".join(
        [
            name,
            *(f"{each:g}" if isinstance(each, float | int) else shlex.quote(str(each)) for each in several),
        ]
    )
