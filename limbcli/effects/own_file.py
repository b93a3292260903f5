"""A user-defined effect from a Python file, checked before it is used.

Errors that the file's functions raise later are reported with the file's name and line.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import Any, get_args

from limbcli.effects.effect import NUMERICAL, Effect, Kind, same_model, same_reading
from limbcli.effects.reading import Reading
from limbcli.errors import CaseError, LimbError
from limbcli.model import LimbModel

_MODULE = "limbcli_effect_of_the_user"  # module name while it runs; dataclasses look it up
_KINDS = tuple(each for each in get_args(Kind) if each != NUMERICAL)
_CHANNELS = ("force", "swe", "map", "travel", "skin-bone", "hold", "bone")
_FIX = (
    "write a file like those in limbcli/effects, with `EFFECT = Effect(...)`; docs/add-an-effect.md has one"
)


def effect_of_file(path: Path, known: Sequence[Effect]) -> Effect:
    """The `EFFECT` of a Python file.

    known : effects whose names, and those of their parameters, are already in use

    Raises CaseError if the file cannot be run, defines no effect, or defines one that cannot be used: of an
    unsupported kind, without a function that changes anything, or with bounds that do not contain the null
    and the start.
    """
    found = getattr(_run(path), "EFFECT", None)
    if not isinstance(found, Effect):
        raise CaseError("the effect file defines no EFFECT", where=str(path), fix=_FIX)
    # the same effect with functions whose errors name the file
    kinds = {"apply": LimbModel, "observe": Reading, "waves": LimbModel, "stiffness": object}
    own = {name: getattr(found, name) for name in kinds}
    changed: dict[str, Any] = {
        name: _with_its_errors(each, name, kinds[name], path)
        for name, each in own.items() if each not in (None, same_model, same_reading)
    }  # fmt: skip
    guarded = replace(found, **changed)
    for wrong, fix in _wrong(guarded, known):
        raise CaseError(f"the effect of the file cannot be tried: {wrong}", where=str(path), fix=fix)
    return guarded


def _run(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(_MODULE, path) if path.is_file() else None
    if spec is None or spec.loader is None:
        what = "is not a Python file (.py)" if path.is_file() else "is not there"
        raise CaseError(f"the effect file {path} {what}", where="--effect-file", fix=_FIX)
    module = importlib.util.module_from_spec(spec)
    sys.modules[_MODULE] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # any error of a user's file is reported with its name
        at = error.lineno if isinstance(error, SyntaxError) else _line(error, path)
        what = f"the effect file does not run ({_error_text(error)})"
        raise CaseError(what, where=f"{path}, line {at}" if at else str(path), fix=_FIX) from error
    return module


def _wrong(effect: Effect, known: Sequence[Effect]) -> Iterator[tuple[str, str]]:
    """(what, fix) of each problem that prevents the use of the effect."""
    if not isinstance(effect.name, str) or not re.fullmatch(r"[\w-]+", effect.name):
        yield f"its name is {effect.name!r}", "name it with letters, digits, '-' and '_' only"
    if effect.name in {each.name for each in known}:
        yield f"there is an effect {effect.name!r} already", "give it another name"
    if effect.kind not in _KINDS:
        yield f"its kind is {effect.kind!r}", f"give one of {', '.join(map(repr, _KINDS))}"
    for channel in effect.needs:
        if channel not in _CHANNELS:
            yield f"it needs {channel!r}", f"needs may hold {', '.join(map(repr, _CHANNELS))}"
    for p in effect.parameters:
        for name, value in {"null": p.null, "start": p.start, "typical": p.typical}.items():
            if not p.low <= value <= p.high:
                what = f"{name} of {p.name} is {value:g}, outside of its bounds {p.low:g} to {p.high:g}"
                yield what, "choose low and high so that they include null, start and typical"
        if p.start == p.null and not p.shape:
            yield f"start of {p.name} is its null, {p.null:g}", "start a fit where the effect is present"
        if p.typical == p.null and not p.shape:
            yield (
                f"typical of {p.name} is its null, {p.null:g}",
                "give a size that is plausible if the effect is present",
            )
        taken = [each.name for each in known if p.name in {other.name for other in each.parameters}]
        if taken:
            yield f"{taken[0]!r} has a parameter {p.name} already", "give that of the file another name"
    if not effect.parameters:
        yield "it has no parameters", "give it one: Effect(..., parameters=(Parameter(...),))"
    if effect.apply is same_model and effect.observe is same_reading and effect.stiffness is None:
        yield "it changes nothing", "give it observe(reading, theta), or apply(model, theta) and solves=True"
    elif effect.observe is same_reading and not effect.solves:
        yield (
            "its apply would never be called",
            "set solves=True, as an effect of the model has to be simulated",
        )
    for point in effect.grid:
        if effect.observe(Reading(), {**effect.null, **point}) != Reading():
            yield (
                "its null value changes the reading",
                "let observe return the reading unchanged where theta is null",
            )
        effect.observe(Reading(), {**effect.start, **point})


def _with_its_errors(function: Callable[..., Any], name: str, kind: type, path: Path) -> Callable[..., Any]:
    def called(*given: Any) -> Any:
        try:
            found = function(*given)
        except LimbError:
            raise
        except Exception as error:  # as above
            at = _line(error, path)
            where = f"{path}, line {at}" if at else str(path)
            what = f"{name} of the effect file fails ({_error_text(error)})"
            raise CaseError(what, where=where, fix="correct that line") from error
        if not isinstance(found, kind):
            what = f"{name} of the effect file returns {type(found).__name__}, not a {kind.__name__}"
            raise CaseError(what, where=str(path), fix="return an altered copy of its argument")
        return found

    return called


def _error_text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _line(error: Exception, path: Path) -> int | None:
    """Line of the file through which the error last passed; None if it did not."""
    own = path.resolve()
    lines = [each.lineno for each in extract_tb(error.__traceback__) if Path(each.filename).resolve() == own]
    return lines[-1] if lines else None
