"""The functions and the command line take the same options, with the same defaults and bounds."""

from __future__ import annotations

import inspect
import math
from pathlib import Path
from typing import Any

import pytest
import typer

import limbcli
from limbcli.api.limits import LIMITS
from limbcli.cli.app import COMMANDS, app
from limbcli.stages.mesh import mesh_options
from tests.case.test_case_text import two_sites

FUNCTIONS = {
    "segment": "segment", "mesh": "mesh", "build-feb": "build_feb", "run": "run", "fit": "fit",
    "diagnose": "diagnose", "report": "report", "measure": "measure", "synth": "synth",
    "phantom": "make_phantom", "check": "check", "batch": "batch", "cohort": "cohort",
    "limb": "limb", "socket": "socket",
}  # fmt: skip
# What belongs to a terminal alone, and options that are functions of their own.
TERMINAL = {"json", "quiet", "verbose", "no_wait", "open", "help"}
OF_THEIR_OWN = {
    "run": {"feb"},
    "fit": {"objective", "law", "compare_laws", "compare_element"},
    "report": {"index"},
}
RENAMED = {"seeds": "seed", "sites": "site", "layers": "layer", "subject": "name", "effects": "effect",
           "draws": "draw"}  # fmt: skip
PYTHON_ONLY = {"wait", "progress"}


GROUP = typer.main.get_command(app)


def options(command: str) -> dict[str, Any]:
    """The command's options, called as on the command line, with underscores."""
    found = {}
    for each in GROUP.commands[command].params:  # type: ignore[attr-defined]
        longs = [text.lstrip("-").replace("-", "_") for text in each.opts if text.startswith("--")]
        found[longs[0] if longs else str(each.name)] = each
    return {name: each for name, each in found.items() if name not in TERMINAL}


@pytest.mark.parametrize("command", FUNCTIONS)
def test_a_function_takes_what_its_command_takes(command: str):
    function = inspect.signature(getattr(limbcli, FUNCTIONS[command])).parameters
    mine = {_as_option(command, name) for name in function} - PYTHON_ONLY
    theirs = set(options(command)) - OF_THEIR_OWN.get(command, set())
    assert mine == theirs


@pytest.mark.parametrize("command", FUNCTIONS)
def test_the_defaults_are_the_same(command: str):
    known = options(command)
    for name, each in inspect.signature(getattr(limbcli, FUNCTIONS[command])).parameters.items():
        option = _as_option(command, name)
        if option in PYTHON_ONLY or each.default is inspect.Parameter.empty:
            continue
        default = known[option].default
        assert (each.default or None) == (default or None), f"{command} --{option}"


@pytest.mark.parametrize("command", [each for each in FUNCTIONS if each != "check"])
def test_the_bounds_are_the_same(command: str):
    bounded = {}
    for name, each in options(command).items():
        bearer = each if hasattr(each, "min") else getattr(each, "type", None)  # by Typer's version
        low, high = getattr(bearer, "min", None), getattr(bearer, "max", None)
        if low is not None or high is not None:
            bounded[_as_argument(command, name)] = (
                -math.inf if low is None else low,
                math.inf if high is None else high,
            )
    assert LIMITS.get(FUNCTIONS[command].removeprefix("make_"), {}) == bounded


@pytest.mark.parametrize("name", ["size_mm", "far_size_mm", "margin_mm"])
def test_every_size_within_the_bounds_of_help_is_taken(tmp_path: Path, name: str):
    case = limbcli.Case.open(two_sites(tmp_path / "case"))
    argument = name.removesuffix("_mm")
    for bound in LIMITS["mesh"][name]:
        given = {"element": None, "size": None, "far_size": None, "margin": None, argument: bound}
        if name == "far_size_mm":
            given["size"] = 0.8
        assert mesh_options(case, **given)  # type: ignore[arg-type]


def test_every_command_has_its_function():
    """All but those that help with the terminal."""
    assert set(COMMANDS) - set(FUNCTIONS) <= {"new", "doctor"}


def _as_option(command: str, name: str) -> str:
    if command == "segment" and name == "smooth_mm":
        return "smooth"  # --smooth MM
    if command == "diagnose" and name == "effects":
        return name
    if command == "phantom" and name == "subject":
        return "id"
    return RENAMED.get(name, name)


def _as_argument(command: str, option: str) -> str:
    return "smooth_mm" if (command, option) == ("segment", "smooth") else option
