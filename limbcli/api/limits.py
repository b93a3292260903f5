"""Ranges of numeric arguments: the bounds of the command-line options of the same names."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np

from limbcli.errors import CaseError
from limbcli.mesh_bounds import (
    FAR_SIZE_MM,
    LIMB_CUT_MM,
    LIMB_NODES,
    LIMB_SITE_SIZE_MM,
    MARGIN_MM,
    SIZE_MM,
    SOCKET_PENALTY,
    SOCKET_STEPS,
)

Bounds: TypeAlias = tuple[float, float]

# (lowest, largest); infinite where an option has no such end. A test holds them against the options.
_SIZES: dict[str, Bounds] = {"size_mm": SIZE_MM, "far_size_mm": FAR_SIZE_MM, "margin_mm": MARGIN_MM}
_TISSUE: dict[str, Bounds] = {"c_kpa": (0.1, 200), "f_kappa": (0.01, 1000), "m": (1, 100)}
_MEASURING: dict[str, Bounds] = {
    "noise": (0, 20), "step_n": (0.1, 20), "max_force_n": (1, 80), "max_strain": (0.05, 0.6),
}  # fmt: skip
_SEED: dict[str, Bounds] = {"seed": (0, math.inf)}
LIMITS: dict[str, dict[str, Bounds]] = {
    "segment": {"smooth_mm": (0, 5)},
    "mesh": _SIZES,
    "build_feb": {"f_kappa": (0.01, 1000), "m": (1, 100), "contact_penalty": (1, 1000)},
    "batch": {"jobs": (1, math.inf)},
    "cohort": {**_SEED},
    "limb": {"nodes": LIMB_NODES, "cut_mm": LIMB_CUT_MM, "site_size_mm": LIMB_SITE_SIZE_MM},
    "socket": {
        "donning_steps": SOCKET_STEPS, "load_steps": SOCKET_STEPS, "contact_penalty": SOCKET_PENALTY,
    },
    "run": {"time_limit_s": (0, math.inf)},
    "fit": {"max_iterations": (1, math.inf)},
    "diagnose": {"max_effects": (1, 2), **_SEED, "size_mm": (1, 20), "far_size_mm": (2, 50)},
    "synth": {
        **_SEED, **_TISSUE, **_MEASURING, **_SIZES, "contact_penalty": (1, 1000),
        "unloaded_stretch_along": (0.5, 2), "unloaded_stretch_around": (0.5, 2),
    },
    "phantom": {**_SEED, **_TISSUE, **_MEASURING, **_SIZES},
}  # fmt: skip
_WHOLE = ("seed", "max_effects", "max_iterations", "jobs", "nodes", "donning_steps", "load_steps")


def within(function: str, **values: object) -> None:
    """Check that the numbers are within their ranges; None stands for a default.

    Raises
    ------
    CaseError
        Names the argument and the allowed range.

    >>> within("segment", smooth_mm=9.0)
    Traceback (most recent call last):
    limbcli.errors.CaseError: smooth_mm is 9, outside of 0 to 5
      where: segment(smooth_mm=9.0)
      fix:   give a number from 0 to 5
    """
    for name, value in values.items():
        if value is None:
            continue
        low, high = LIMITS.get(function, {}).get(name, (-math.inf, math.inf))
        where = f"{function}({name}={value!r})"
        meant = _meant(low, high)
        kind = numbers.Integral if name in _WHOLE else numbers.Real
        if isinstance(value, bool) or not isinstance(value, kind) or not math.isfinite(float(value)):
            what = "a whole number" if name in _WHOLE else "a finite number"
            raise CaseError(f"{name} is {value!r}, not {what}", where=where, fix=f"give {meant}")
        if not low <= float(value) <= high:
            raise CaseError(
                f"{name} is {float(value):g}, outside of {low:g} to {high:g}",
                where=where,
                fix=f"give {meant}",
            )


def _meant(low: float, high: float) -> str:
    if math.isinf(low):
        return "a number"
    return f"a number from {low:g}" + ("" if math.isinf(high) else f" to {high:g}")


def one_of(function: str, known: Iterable[str], **values: object) -> None:
    """Check that the words are known; None stands for a default.

    Raises
    ------
    CaseError
        Names the argument and the known words.
    """
    known = list(known)
    for name, value in values.items():
        if value is not None and value not in known:
            raise CaseError(
                f"{name} is {value!r}",
                where=f"{function}({name}={value!r})",
                fix=f"give {' or '.join(known)}",
            )


def flags_and_numbers(function: Callable[..., Any], given: Mapping[str, object]) -> None:
    """Check that arguments with a default of True or False are given as such, and that no number is given as
    None.

    Raises
    ------
    CaseError
        Names the argument and the allowed values.
    """
    defaults = {name: each.default for name, each in inspect.signature(function).parameters.items()}
    for name, value in given.items():
        default = defaults.get(name)
        if isinstance(default, bool) and not (isinstance(value, bool | np.bool_ | int) and value in (0, 1)):
            what, fix = "neither True nor False", "give True or False"
        elif isinstance(default, int | float) and value is None:
            what, fix = "not a number", f"leave it out: {default:g}"
        else:
            continue
        where = f"{function.__name__}({name}={value!r})"
        raise CaseError(f"{name} is {value!r}, {what}", where=where, fix=fix)


def tables(function: str, example: Mapping[str, object], **values: object) -> None:
    """Check that numbers by name are given as a mapping like the example; None stands for none.

    Raises
    ------
    CaseError
        Names the argument and the allowed values.
    """
    for name, value in values.items():
        if value is not None and not isinstance(value, Mapping):
            raise CaseError(
                f"{name} is {value!r}, not a table",
                where=f"{function}({name}={value!r})",
                fix=f"give numbers by name, such as {dict(example)}",
            )
