"""The functions and the command line take the same options, with the same defaults and bounds."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest
import typer

import limbcli
from limbcli.cli.app import COMMANDS, app
from limbcli.errors import CaseError
from limbcli.options import Argument, arguments_of
from limbcli.stages.mesh import MeshRequest, mesh_options
from tests.case.test_case_text import two_sites

FUNCTIONS = {name: name.replace("-", "_") for name in COMMANDS} | {"phantom": "make_phantom"}
OF_THE_TERMINAL = {"doctor", "new"}
# What belongs to a terminal alone, and options that are functions of their own.
TERMINAL = {"--json", "--quiet", "--verbose", "--no-wait", "--open", "--help"}
OF_THEIR_OWN = {
    "run": {"--feb"},
    "fit": {"--objective", "--law", "--compare-laws", "--compare-element"},
    "report": {"--index"},
}
SAME = sorted(set(COMMANDS) - OF_THE_TERMINAL)
GROUP = typer.main.get_command(app)


def options(command: str) -> dict[str, Any]:
    """The command's options by their long names; an argument by its own."""
    found = {each.opts[0]: each for each in GROUP.commands[command].params}  # type: ignore[attr-defined]
    return {name: each for name, each in found.items() if name not in TERMINAL}


def arguments(command: str) -> dict[str, Argument]:
    """The function's arguments, by the names of the command's options."""
    found = arguments_of(inspect.unwrap(getattr(limbcli, FUNCTIONS[command]))).values()
    return {
        each.flags[0].partition("/")[0] if each.flags else each.name: each
        for each in found
        if each.name not in ("wait", "progress")
    }


@pytest.mark.parametrize("command", SAME)
def test_a_function_takes_what_its_command_takes(command: str):
    assert set(arguments(command)) == set(options(command)) - OF_THEIR_OWN.get(command, set())


@pytest.mark.parametrize("command", SAME)
def test_the_defaults_are_the_same(command: str):
    known = options(command)
    for name, each in arguments(command).items():
        if not each.required:
            assert (each.default or None) == (known[name].default or None), f"{command} {name}"


BOUNDED = [
    (command, name)
    for command in SAME
    for name, each in arguments(command).items()
    if each.option.bounds != (None, None)
]


@pytest.mark.parametrize(("command", "name"), BOUNDED)
def test_the_bounds_are_the_same(command: str, name: str, tmp_path: Path):
    low, high = arguments(command)[name].option.bounds
    typed = options(command)[name]
    bearer = typed if hasattr(typed, "min") else typed.type  # by Typer's version
    assert (bearer.min, bearer.max) == (low, high)
    function = getattr(limbcli, FUNCTIONS[command])
    places = [tmp_path] * sum(each.required for each in arguments(command).values())
    with pytest.raises(CaseError, match=f"give a number from {low:g}"):
        function(*places, **{arguments(command)[name].name: low - 1})


@pytest.mark.parametrize("name", ["size_mm", "far_size_mm", "margin_mm"])
def test_every_size_within_the_bounds_of_help_is_taken(tmp_path: Path, name: str):
    case = limbcli.Case.open(two_sites(tmp_path / "case"))
    argument = name.removesuffix("_mm")
    for bound in arguments_of(inspect.unwrap(limbcli.mesh))[name].option.bounds:
        given = {argument: bound}
        if name == "far_size_mm":
            given["size"] = 0.8
        assert mesh_options(case, MeshRequest(**given))  # type: ignore[arg-type]


def test_the_documentation_states_what_the_option_states():
    text = inspect.getdoc(limbcli.mesh) or ""
    assert "size_mm : Edge length of elements under the probe, mm; default: 2.5. From 0.8 to 10." in text
    assert text.index("Parameters\n---") < text.index("size_mm :") < text.index("Raises\n---")
