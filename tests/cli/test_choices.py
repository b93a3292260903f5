"""Options with few values: what shells complete, and what is refused before any work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import pytest
from typer.testing import CliRunner

from limbcli.api.diagnosis import MEASURED
from limbcli.cli.app import app, main
from limbcli.cli.command import effect_names
from limbcli.diagnosis.forward_model.measurement_menu import items
from limbcli.effects import EFFECTS
from limbcli.fitting.laws import LAWS
from limbcli.options import LawName, SolverName
from limbcli.solvers import KINDS

CASES = Path(__file__).resolve().parents[2] / "cases"


def completed(*words: str) -> list[str]:
    """What bash offers for the last word."""
    line = " ".join(["limbcli", *words])
    asked = {"_LIMBCLI_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words))}
    return CliRunner().invoke(app, env=asked, prog_name="limbcli").output.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["mesh", "S1", "--element", ""], ["tet10", "tet4"]),
        (["batch", "S1", "--element", "tet1"], ["tet10"]),
        (["synth", "S1", "--element", ""], ["tet10", "tet4"]),
        (["fit", "S1", "--solver", ""], ["auto", "febio", "reference"]),
        (["fit", "S1", "--objective", ""], ["force", "joint", "states"]),
        (["fit", "S1", "--law", "two"], ["two-term-ogden"]),
        (["fit", "S1", "--cycle", ""], ["last"]),
        (["segment", "S1", "--limb", ""], ["left", "right"]),
        (["mesh", "S1", "--skin-mm", "m"], ["mri"]),
        (["limb", "S1", "--fat-mm", ""], ["mri"]),
        (["synth", "S1", "--effect", "skin"], ["skin-layer"]),
        (["diagnose", "S1", "--effects", "skin"], ["skin-layer"]),
        (["diagnose", "S1", "--measured", "tare"], ["tare_n="]),
        (["build-feb", "S1", "--layer", ""], ["fat:", "skin:"]),
        (["segment", "S1", "--seed", "b"], ["bone="]),
        (["fit", str(CASES / "paper-parameters"), "--site", ""], ["S1", "S2-left", "S2-right"]),
        (["fit", "nowhere", "--site", ""], []),
    ],
)
def test_a_shell_completes(words: list[str], offered: list[str]):
    assert completed(*words) == offered


@pytest.mark.parametrize(
    ("arguments", "fix"),
    [
        (["mesh", "S1", "--element", "hex8"], "use tet10 or tet4"),
        (["batch", "S1", "--element", "hex8"], "use tet10 or tet4"),
        (["synth", "S1", "--element", "hex8"], "use tet10 or tet4"),
        (["limb", "S1", "--element", "hex8"], "use tet10 or tet4"),
        (["segment", "S1", "--limb", "both"], "use left or right"),
        (["run", "S1", "--solver", "reverence"], "use auto, febio or reference; did you mean 'reference'?"),
    ],
)
def test_another_value_is_refused_before_the_case_is_read(arguments: list[str], fix: str, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--json"])
    shown = json.loads(capsys.readouterr().out)
    assert stopped.value.code == 2
    assert shown["fix"] == fix
    assert shown["where"] == arguments[2]


def test_the_words_are_those_of_the_program():
    assert get_args(SolverName) == KINDS
    assert get_args(LawName) == tuple(LAWS), "list the law in LawName of limbcli/options.py, in this order"
    assert effect_names("") == [each.name for each in EFFECTS]
    assert set(MEASURED) == {each.given for each in items() if each.given}
