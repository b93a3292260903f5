"""A command, made from the function that declares its options and does its work."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from limbcli.cli.terminal import emit, terminal
from limbcli.cli.values import VALUE_OF
from limbcli.errors import CaseError
from limbcli.errors.problems import similar
from limbcli.options import Argument, arguments_of

_TERMINAL = {
    "json": Annotated[bool, typer.Option("--json", help="Print the result as JSON.")],
    "quiet": Annotated[bool, typer.Option("--quiet", "-q", help="No progress; only the result.")],
    "verbose": Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="More output; twice: all of it.")
    ],
}
_NO_WAIT = Annotated[
    bool,
    typer.Option("--no-wait", help="Fail immediately if another limbcli is writing into the output folder."),
]


def command_of(
    function: Callable[..., Any], text: str, *, like: tuple[Callable[..., Any], ...] = ()
) -> Callable[..., None]:
    """The command that calls a function with its options, and shows the result.

    text : its help
    like : functions whose options it takes too, as `**options`

    A function that takes `json` shows its result itself.
    """
    work = inspect.unwrap(function)
    own = inspect.signature(work).parameters
    arguments = _in_order([work, *map(inspect.unwrap, like)])
    waits = arguments.pop("wait", None) is not None
    heard = arguments.pop("progress", None) is not None or "progress" in own

    def command(**given: Any) -> None:
        as_json = given.pop("json")
        progress = terminal(quiet=given.pop("quiet"), verbose=given.pop("verbose"))
        extra: dict[str, Any] = {"wait": not given.pop("no_wait")} if waits else {}
        extra |= {"json": as_json} if "json" in own else {}
        extra |= {"progress": progress} if heard else {}
        found = work(**{name: _value(arguments[name], each) for name, each in given.items()}, **extra)
        if "json" not in own:
            emit(found, as_json=as_json)

    hints = {name: _hint(each) for name, each in arguments.items()}
    hints |= {"no_wait": _NO_WAIT} if waits else {}
    hints |= _TERMINAL
    command.__doc__ = text
    command.__annotations__ = hints
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                annotation=hint,
                default=_default(arguments.get(name), name),
            )
            for name, hint in hints.items()
        ]
    )
    return command


def _in_order(functions: list[Callable[..., Any]]) -> dict[str, Argument]:
    """The arguments of all functions, each once; one with `before` stands before that one."""
    found: dict[str, Argument] = {}
    for each in functions:
        found = {**found, **{name: one for name, one in arguments_of(each).items() if name not in found}}
    names = [name for name, one in found.items() if not one.option.before]
    for name, one in found.items():
        if one.option.before:
            names.insert(names.index(one.option.before), name)
    return {name: found[name] for name in names}


def _hint(argument: Argument) -> Any:
    """The argument as Typer declares it."""
    option = argument.option
    declare = typer.Option if argument.flags else typer.Argument
    low, high = option.bounds
    words = (*argument.words, *option.such_as)
    complete = _WHEN_ASKED.get(argument.name) or (_those_of(words) if words else None)
    refuse = _others_than(argument.words) if argument.words and len(argument.kinds) == 1 else None
    declared = declare(
        *argument.flags,
        help=option.help,
        metavar=option.metavar,
        min=low,
        max=high,
        autocompletion=complete,
        callback=refuse,
    )
    return Annotated[argument.kind, declared]


def _default(argument: Argument | None, name: str) -> Any:
    if argument is None:
        return 0 if name == "verbose" else False
    return None if argument.default == () else argument.default


def _value(argument: Argument, given: Any) -> Any:
    """What the function takes, from what the command line gave; nothing given: the function's default."""
    if given is None or given == [] or given == ():
        return argument.default
    flag = argument.flags[0] if argument.flags else ""
    return VALUE_OF[argument.name](given, flag) if argument.name in VALUE_OF else given


# Options with few or known values: shells complete them, and another of few is refused before any work.


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


def effect_names(incomplete: str) -> list[str]:
    """Names of effects."""
    from limbcli.stages.diagnose import EFFECTS

    return _those_of([each.name for each in EFFECTS])(incomplete)


def _sites(ctx: typer.Context, incomplete: str) -> list[str]:
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
_WHEN_ASKED: dict[str, Callable[..., list[str]]] = {"effects": effect_names, "sites": _sites}
