"""Checks of arguments against their options: kind and range of numbers, known words, True or False."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from typing import Any

from limbcli.errors import CaseError
from limbcli.options import Argument, Bounds


def check_arguments(function: str, arguments: Mapping[str, Argument], given: Mapping[str, object]) -> None:
    """Check the arguments of a call; None stands for a default.

    Raises
    ------
    CaseError
        Names the argument and what it may be.
    """
    for name, value in given.items():
        if name in arguments:
            _check(function, arguments[name], value)


def _check(function: str, argument: Argument, value: Any) -> None:
    import numpy as np  # which help and messages do not need

    name, default, option = argument.name, argument.default, argument.option
    if isinstance(default, bool):
        if not (isinstance(value, bool | np.bool_ | int) and value in (0, 1)):
            raise _wrong(function, name, value, "neither True nor False", "give True or False")
    elif value is None:
        if isinstance(default, int | float):
            raise _wrong(function, name, value, "not a number", f"leave it out: {default:g}")
    elif argument.words and float not in argument.kinds:
        one_of(function, argument.words, name, value)
    elif option.example is not None:
        if not isinstance(value, Mapping):
            fix = f"give numbers by name, such as {dict(option.example)}"
            raise _wrong(function, name, value, "not a table", fix)
        for key, each in value.items():
            within(function, key, each)
    elif argument.words and isinstance(value, str):
        pass  # its stage checks it
    elif float in argument.kinds or argument.kinds == (int,):
        within(function, name, value, option.bounds, whole=argument.kinds == (int,))


def within(
    function: str, name: str, value: Any, bounds: Bounds = (None, None), *, whole: bool = False
) -> None:
    """Check that a number is within its range.

    Raises
    ------
    CaseError
        Names the argument and the allowed range.

    >>> within("segment", "smooth_mm", 9.0, (0, 5))
    Traceback (most recent call last):
    limbcli.errors.CaseError: smooth_mm is 9, outside of 0 to 5
      where: segment(smooth_mm=9.0)
      fix:   give a number from 0 to 5
    """
    low, high = bounds
    meant = (
        "a number" if low is None else f"a number from {low:g}" + ("" if high is None else f" to {high:g}")
    )
    kind = numbers.Integral if whole else numbers.Real
    if isinstance(value, bool) or not isinstance(value, kind) or not math.isfinite(float(value)):
        what = f"not {'a whole' if whole else 'a finite'} number"
        raise _wrong(function, name, value, what, f"give {meant}")
    least, most = -math.inf if low is None else low, math.inf if high is None else high
    if not least <= float(value) <= most:
        what, shown = f"outside of {least:g} to {most:g}", f"{float(value):g}"
        raise _wrong(function, name, value, what, f"give {meant}", shown=shown)


def one_of(function: str, known: Iterable[str], name: str, value: object) -> None:
    """Check that a word is known.

    Raises
    ------
    CaseError
        Names the argument and the known words.
    """
    known = list(known)
    if value not in known:
        raise _wrong(function, name, value, "", f"give {' or '.join(known)}")


def _wrong(
    function: str, name: str, value: object, what: str, fix: str, *, shown: str | None = None
) -> CaseError:
    is_so = f"{name} is {repr(value) if shown is None else shown}" + (f", {what}" if what else "")
    return CaseError(is_so, where=f"{function}({name}={value!r})", fix=fix)
