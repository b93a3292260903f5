"""What a command passes on to the function that it is made from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from limbcli.api.geometry import segment
from limbcli.api.making import synth
from limbcli.api.simulation import build_feb
from limbcli.cli.command import command_of
from limbcli.options import CASE, SITES, WAIT, Option


def passed_on(*words: str, like: Any = None) -> dict[str, Any]:
    """The arguments that a function gets from a command line."""
    found: dict[str, Any] = {}

    def function(
        case: Annotated[Path, CASE],
        *,
        sites: Annotated[list[str] | None, SITES] = None,
        size_mm: Annotated[float | None, Option("Edge length.", (0.8, 10.0))] = None,
        wait: Annotated[bool, WAIT] = True,
        json: bool,
        **others: Any,
    ) -> None:
        found.update(others, case=case, sites=sites, size_mm=size_mm, wait=wait, json=json)

    app = typer.Typer()
    app.command()(command_of(function, "Make it.", like=(like,) if like else ()))
    result = CliRunner().invoke(app, list(words))
    found["exit_code"] = result.exit_code
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return found


def test_given_options_and_the_functions_own_defaults():
    given = passed_on("S12", "-s", "p1", "--size-mm", "3", "--no-wait", "--json")
    assert given == {
        "case": Path("S12"), "sites": ["p1"], "size_mm": 3.0, "wait": False, "json": True, "exit_code": 0,
    }  # fmt: skip
    assert passed_on("S12")["sites"] is None
    assert passed_on("S12", "--size-mm", "11") == {"exit_code": 2}


@pytest.mark.parametrize(
    ("like", "words", "name", "value"),
    [
        (segment, ["--seed", "bone=1,-2.5,30"], "seeds", [("bone", (1.0, -2.5, 30.0))]),
        (segment, ["--smooth", "2"], "smooth_mm", 2.0),
        (segment, ["--limb", "left"], "limb", "left"),
        (build_feb, ["--layer", "fat:c_kpa=2"], "layers", {"fat": {"c_kpa": 2.0}}),
        (build_feb, [], "layers", None),
        (synth, ["--out-case", "S13", "--stretch-along", "bent=0.8"], "stretch_along", {"bent": 0.8}),
        (synth, ["--out-case", "S13", "--effect", "skin-layer"], "effects", ["skin-layer"]),
        (synth, ["--out-case", "S13"], "effects", ()),
    ],
)
def test_values_reach_the_function_as_python_takes_them(like: Any, words: list[str], name: str, value: Any):
    assert passed_on("S12", *words, like=like)[name] == value


@pytest.mark.parametrize("words", [["--seed", "bone=1,2"], ["--seed", "skin=1,2,3"], ["--smooth", "6"]])
def test_values_that_no_command_takes_end_with_exit_code_2(words: list[str]):
    assert passed_on("S12", *words, like=segment) == {"exit_code": 2}
