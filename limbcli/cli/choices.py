"""Options with few or known values: shells complete them, and another of few is refused before any work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from limbcli.errors import CaseError
from limbcli.errors.problems import similar
from limbcli.options import Argument


def of(argument: Argument) -> dict[str, Any]:
    """Arguments of `typer.Option` for an argument with few, or with known, values."""
    words = (*argument.words, *argument.option.such_as)
    complete = _WHEN_ASKED.get(argument.name) or (_those_of(words) if words else None)
    refuse = _others_than(argument.words) if argument.words and len(argument.kinds) == 1 else None
    return {"autocompletion": complete, "callback": refuse}


def _those_of(words: Sequence[str]) -> Callable[[str], list[str]]:
    """
    >>> _those_of(["left", "right"])("l")
    ['left']
    """

    def complete(incomplete: str) -> list[str]:
        return [each for each in words if each.startswith(incomplete)]

    return complete


def _others_than(words: Sequence[str]) -> Callable[[typer.CallbackParam, str | None], str | None]:
    def refuse(param: typer.CallbackParam, value: str | None) -> str | None:
        if value is None or value in words:
            return value
        listed = f"{', '.join(words[:-1])} or {words[-1]}"
        near = similar(value, words)
        hint = f"; {near}" if near else ""
        raise CaseError(f"{value!r} is not possible here", where=param.opts[0], fix=f"use {listed}{hint}")

    return refuse


def effects(incomplete: str) -> list[str]:
    """Names of effects."""
    from limbcli.stages.diagnose import EFFECTS

    return _those_of([each.name for each in EFFECTS])(incomplete)


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
    return _those_of([str(each.get("name")) for each in tables if isinstance(each, dict)])(incomplete)


# Known only from files or heavy modules, by the argument's name.
_WHEN_ASKED: dict[str, Callable[..., list[str]]] = {"effects": effects, "sites": sites}
