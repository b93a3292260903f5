"""Errors as this command line can use them: its own case in the commands, its own options in the advice."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from limbcli.pasting import AnyError, pasted

_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_OTHERS = re.compile(r"(limbcli|pip|apt-get|fslroi) [^`;,\n]*")


def for_command_line(error: AnyError, arguments: Sequence[str]) -> AnyError:
    """The error with what can be pasted; an option that the command lacks is told with one that has it."""
    case = case_of(arguments)
    told = pasted(error, case, out_of(arguments))
    name = arguments[0] if arguments else ""
    strangers = list(dict.fromkeys(_strangers(told.fix, name)))
    if not strangers:
        return told
    place = shlex.quote(str(case)) if case else "CASE"
    said = [f"{each} is an option of `limbcli {owner_of(each)} {place}`" for each in strangers]
    return type(told)(told.what, where=told.where, fix=f"{told.fix} ({'; '.join(said)})", **told.facts)


def case_of(arguments: Sequence[str]) -> Path | None:
    """The case folder among the arguments; None where there is none, or several."""
    named = [Path(each) for each in arguments[1:] if not each.startswith("-")]
    cases = [each for each in named if (each / "case.toml").is_file()]
    return cases[0] if len(cases) == 1 else None


def out_of(arguments: Sequence[str]) -> Path | None:
    """The output folder that the arguments name, if any."""
    for before, text in zip(["", *arguments], arguments, strict=False):
        if before in ("--out", "-o"):
            return Path(text)
        if text.startswith("--out="):
            return Path(text.removeprefix("--out="))
    return None


def _strangers(fix: str, command: str) -> Iterator[str]:
    """Options in a fix, outside whole commands, that this command does not have and another has."""
    known = options_of(command)
    for found in _OPTION.findall(_OTHERS.sub("", fix)):
        if known and found not in known and owner_of(found):
            yield found


@cache
def options_of(command: str) -> frozenset[str]:
    """Every option of a command; empty where there is no such command."""
    import typer

    from limbcli.cli.app import app

    found = getattr(typer.main.get_command(app), "commands", {}).get(command)
    return frozenset(each for option in found.params for each in option.opts) if found else frozenset()


@cache
def owner_of(option: str) -> str:
    """The first command that has an option, or nothing."""
    from limbcli.cli.app import COMMANDS

    return next((name for name in COMMANDS if option in options_of(name)), "")
