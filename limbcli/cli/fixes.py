"""Adapt errors to the current command line: actual case folder in commands, and options that exist."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path

from limbcli.config import default_out
from limbcli.errors.pasted_commands import AnyError, pasted, typed

Options = Mapping[str, Set[str]]
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_OTHERS = re.compile(r"(limbcli|pip|apt-get|fslroi) [^`;,\n]*|`[a-z][a-z-]* --[^`\n]*`")


def for_command_line(error: AnyError, arguments: Sequence[str], options: Options) -> AnyError:
    """The error with commands that can be pasted; an option that this command lacks is shown with a command
    that has it.

    options : of all commands, in the order in which a new user needs them
    """
    case = case_of(arguments)
    shown = pasted(error, case, out_of(arguments))
    name = arguments[0] if arguments else ""
    strangers = list(dict.fromkeys(_strangers(shown.fix, options.get(name, set()), options)))
    if not strangers:
        return shown
    place = typed(case) if case else "CASE"
    hints = [f"{each} is an option of `limbcli {owner_of(each, options)} {place}`" for each in strangers]
    return type(shown)(shown.what, where=shown.where, fix=f"{shown.fix} ({'; '.join(hints)})", **shown.facts)


def case_of(arguments: Sequence[str]) -> Path | None:
    """The case folder among the arguments; None if there is none, or several."""
    words = list(arguments[1:])
    end = words.index("--") if "--" in words else len(words)
    named = [Path(each) for k, each in enumerate(words) if k > end or not each.startswith("-")]
    cases = [each for each in named if (each / "case.toml").is_file()]
    return cases[0] if len(cases) == 1 else None


def out_of(arguments: Sequence[str]) -> Path | None:
    """The output folder given by the arguments, if any; the last one counts, as for the command itself.

    >>> [out_of(["mesh", "case", *words]) for words in (["--out=a"], ["-ob"], ["-o", "a", "--out", "c"], [])]
    [PosixPath('a'), PosixPath('b'), PosixPath('c'), None]
    """
    found = None
    for before, text in zip(["", *arguments], arguments, strict=False):
        if before in ("--out", "-o"):
            found = Path(text)
        elif text.startswith("--out="):
            found = Path(text.removeprefix("--out="))
        elif text.startswith("-o") and len(text) > 2:
            found = Path(text[2:])
    return found


def _strangers(fix: str, own: Set[str], options: Options) -> Iterator[str]:
    """Options in a fix, outside commands that are named with them, that only other commands have."""
    for found in _OPTION.findall(_OTHERS.sub("", fix)):
        if own and found not in own and owner_of(found, options):
            yield found


def owner_of(option: str, options: Options) -> str:
    """The first command that has an option, or ""."""
    return next((name for name, known in options.items() if option in known), "")


def output_folder(arguments: Sequence[str]) -> Path | None:
    """The output folder of a command line, given or default, if it exists.

    >>> output_folder(["mesh", "case", "--out=/tmp"]).as_posix(), output_folder(["mesh", "-o", "/nowhere"])
    ('/tmp', None)
    """
    case = case_of(arguments)
    found = out_of(arguments) or (default_out(case) if case else None)
    return found if found is not None and found.is_dir() else None
