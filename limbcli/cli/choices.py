"""Options with few possible values: shells complete them, and another value is refused before any work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from limbcli.errors import CaseError
from limbcli.errors.problems import suggestion
from limbcli.options import Argument

OBJECTIVES = ("force", "joint", "states")
LAWS = ("ogden", "mooney-rivlin", "neo-hooke", "two-term-ogden", "holmes-mow", "fibres")
MEASURED = ("tare_n", "force_gain", "first_depth_mm", "rate_ratio")


def of(argument: Argument) -> dict[str, Any]:
    """Arguments of `typer.Option` for an argument with few, or with known, values."""
    if argument.name in _ONLY:
        return among(*_ONLY[argument.name])
    if argument.name == "sites":
        return {"autocompletion": sites}
    if argument.name in _SUCH_AS:
        return such_as(_SUCH_AS[argument.name])
    if not argument.words:
        return {}
    if len(argument.kinds) == 1:
        return among(*argument.words)
    return such_as(lambda: argument.words)


def among(*words: str) -> dict[str, Any]:
    """Arguments of `typer.Option` for an option that takes one of these words.

    >>> among("left", "right")["autocompletion"]("l")
    ['left']
    """

    def refuse(param: typer.CallbackParam, value: str | None) -> str | None:
        if value is None or value in words:
            return value
        listed = f"{', '.join(words[:-1])} or {words[-1]}"
        near = suggestion(value, words)
        hint = f"; {near}" if near.startswith("did you") else ""
        raise CaseError(f"{value!r} is not possible here", where=param.opts[0], fix=f"use {listed}{hint}")

    return {"callback": refuse, **such_as(lambda: words)}


def such_as(words: Callable[[], Sequence[str]]) -> dict[str, Any]:
    """Arguments of `typer.Option` for one that also takes other values; `words` is called when completing."""

    def complete(incomplete: str) -> list[str]:
        return [each for each in words() if each.startswith(incomplete)]

    return {"autocompletion": complete}


def effect_names() -> list[str]:
    """Names of all effects."""
    from limbcli.stages.diagnose import EFFECTS

    return [each.name for each in EFFECTS]


def sites(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the sites of the case that is named before the option; none where it cannot be read."""
    from limbcli.case import CASE_FILE
    from limbcli.case.toml_file import read_toml

    # An option that still lacks its value leaves the words before it unread, in `args`.
    named = (Path(str(each)) / CASE_FILE for each in (ctx.params.get("case"), *ctx.args) if each)
    try:
        tables = read_toml(next(each for each in named if each.is_file())).get("site", [])
    except (OSError, ValueError, StopIteration):
        return []
    names = [str(each.get("name")) for each in tables if isinstance(each, dict)]
    return [each for each in names if each.startswith(incomplete)]


# What the type of an argument does not say, by its name: the words that it is one of, or some that it may be.
_ONLY = {"objective": OBJECTIVES, "law": LAWS}
_SUCH_AS: dict[str, Callable[[], Sequence[str]]] = {
    "effects": effect_names,
    "cycle": lambda: ["last"],
    "measured": lambda: [f"{each}=" for each in MEASURED],
    "layers": lambda: ["fat:", "skin:"],
    "seeds": lambda: ["bone=", "soft="],
}
