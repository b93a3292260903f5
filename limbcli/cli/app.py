"""The command line: one subcommand per file; expected errors are caught only here."""

from __future__ import annotations

import functools
import inspect
import itertools
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from limbcli.cli.commands import COMMANDS, Command
from limbcli.cli.fixes import for_command_line
from limbcli.cli.output import INTERRUPTED, MESSAGE, report_error, results, say
from limbcli.config import at_home
from limbcli.errors import CaseError, LimbError
from limbcli.errors.file_system import NO_MEMORY, in_words
from limbcli.version import __version__


def _print_version(value: bool) -> None:
    if value:
        from limbcli.stages.doctor import solver_versions

        say("\n".join([f"limbcli {__version__}", *solver_versions()]))
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the versions, including those of the solvers.",
        ),
    ] = False,
) -> None:
    pass


def _listed() -> None:
    """A command in the list of all."""


def _never_ended(command: Callable[..., None]) -> Callable[..., None]:
    """The command, with an error where a library ends the process (commands themselves raise typer.Exit)."""

    @functools.wraps(command)
    def run(*arguments: object, **options: object) -> None:
        try:
            command(*arguments, **options)
        except SystemExit as stop:
            raise RuntimeError(f"a library ended the process (exit code {stop.code})") from stop

    return run


@functools.cache
def _app(names: tuple[str, ...], *, listed_only: bool = False) -> typer.Typer:
    """The program with these commands; `listed_only`: without their options, for the list of all commands."""
    made = typer.Typer(
        name="limbcli",
        help="Soft-tissue parameters of a residual limb, from MRI, indentation and shear-wave elastography.",
        no_args_is_help=True,
        add_completion=True,
        rich_markup_mode=None,  # Rich's tables truncate option names on a terminal of 80 columns
        context_settings={"help_option_names": ["-h", "--help"]},
        pretty_exceptions_enable=False,
    )
    made.callback()(_root)
    for name in names:
        each = COMMANDS[name]
        first = inspect.cleandoc(each.help()).partition("\n\n")[0]
        made.command(name, short_help=" ".join(first.split()), epilog=f"Example: {each.example}")(
            _listed if listed_only else _never_ended(_made(each))
        )
    return made


def _made(command: Command) -> Callable[..., None]:
    from limbcli.cli.command import command_of

    function, *like = command.functions()
    return command_of(function, command.help(), like=tuple(like))


def __getattr__(name: str) -> typer.Typer:
    """`app` is the program with all commands."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _app(tuple(COMMANDS))


def main(arguments: list[str] | None = None) -> None:
    """Run a command; each expected error becomes a message and the exit code of its family."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        arguments = list(map(_from_home, arguments))
        # `nan`, `inf` and 1e999 parse as numbers and may pass range checks, but no option accepts them
        for before, text in itertools.pairwise(["", *arguments]):
            option, _, value = (
                text.rpartition("=") if text.startswith("--") and "=" in text else (before, "", text)
            )
            if option.startswith("-") and _is_no_finite_number(value):
                raise CaseError(f"{value!r} is not a number", where=option, fix="give a finite number")
        only = tuple(each for each in arguments[:1] if each in COMMANDS)
        program = _app(only or tuple(COMMANDS), listed_only=arguments in ([], ["-h"], ["--help"]))
        program(args=arguments, standalone_mode=True)
    except LimbError as error:
        _exit_with(error, arguments)
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            say(MESSAGE, to_stderr=True)
        raise
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), results().fileno())
        sys.exit(1)
    except OSError as error:
        found = in_words(error)
        if found is None:
            raise
        _exit_with(found, arguments)
    except MemoryError:
        _exit_with(NO_MEMORY, arguments)


def command_options() -> dict[str, frozenset[str]]:
    """All options of all commands."""
    found = getattr(typer.main.get_command(_app(tuple(COMMANDS))), "commands", {})
    return {name: frozenset(text for each in found[name].params for text in each.opts) for name in COMMANDS}


def _exit_with(error: LimbError, arguments: Sequence[str]) -> NoReturn:
    report_error(for_command_line(error, arguments, command_options()), as_json="--json" in arguments)
    sys.exit(error.exit_code)


def _from_home(text: str) -> str:
    """Expand `~` at the start of an argument or of the value in `--option=value`, which a shell does not
    expand.

    >>> _from_home("--out=~/results") == f"--out={os.path.expanduser('~/results')}", _from_home("--out=a~")
    (True, '--out=a~')
    """
    option, equals, value = text.partition("=") if text.startswith("--") else ("", "", text)
    return f"{option}{equals}{at_home(Path(value))}" if value.startswith("~") else text


def _is_no_finite_number(text: str) -> bool:
    """
    >>> [each for each in ("nan", "-Inf", "1e999", "2.5", "ogden", "") if _is_no_finite_number(each)]
    ['nan', '-Inf', '1e999']
    """
    try:
        return not math.isfinite(float(text))
    except ValueError:
        return False
