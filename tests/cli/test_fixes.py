"""What messages advise can be pasted: commands, options and paths exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from limbcli.cli.app import COMMANDS, command_options, main
from limbcli.cli.fixes import case_of, for_command_line, out_of
from limbcli.errors import CaseError, SolveError
from limbcli.errors.pasted_commands import WITHOUT_OUT, pasted, pasted_text
from limbcli.provenance.remaking_command import CommandStep
from limbcli.reporting.outcome import read_outcomes
from tests.case.test_case_text import two_sites

PACKAGE = Path(__file__).resolve().parents[2] / "limbcli"
OPTIONS = command_options()
COMMAND = re.compile(r"limbcli ([a-z][a-z-]*)((?: +(?:--?[a-z][a-z-]*|[^\s`;,()\n-][^\s`;,()\n]*))*)")


def advised() -> list[tuple[str, str, str]]:
    """(file, command, the rest) of every command line in a text of the package."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                for name, rest in COMMAND.findall(node.value):
                    found.append((path.relative_to(PACKAGE).as_posix(), name, rest))
    return found


@pytest.mark.slow
def test_options_of_every_advised_command_exist():
    named = [(file, name, rest) for file, name, rest in advised() if name in COMMANDS]
    assert len(named) > 40
    wrong = [
        f"{file}: limbcli {name} {option}"
        for file, name, rest in named
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest)
        if option not in OPTIONS[name]
    ]
    assert not wrong


def test_commands_without_out_are_those():
    assert {name for name in COMMANDS if "--out" not in OPTIONS[name]} == set(WITHOUT_OUT)


def test_commands_name_the_case_and_the_output_folder():
    error = CaseError("a", where="b", fix="run `limbcli mesh CASE --site p1` first, or `limbcli check CASE`")
    reported = pasted(error, Path("/data/my case"), Path("results"))
    assert "`limbcli mesh '/data/my case' --site p1 --out results`" in reported.fix
    assert "`limbcli check '/data/my case'`" in reported.fix
    assert pasted_text("limbcli batch CASE --out out/x", Path("S1"), Path("other")).endswith("--out out/x")


def test_paths_that_are_gone_are_not_told_and_those_that_stay_are(tmp_path: Path):
    gone = tmp_path / ".partial-12-abc" / "model.log"
    assert pasted_text(f"{gone}: ended", None) == "model.log (a temporary file): ended"
    gone.parent.mkdir()
    gone.write_text("x")
    assert str(gone) in pasted_text(f"{gone}: ended", None)


def test_problems_carry_what_can_be_pasted():
    error = CaseError("2 problems", where="b", fix="c", problems=[{"what": "x", "fix": "limbcli check CASE"}])
    assert pasted(error, Path("S1")).facts["problems"][0]["fix"] == "limbcli check S1"


def test_option_of_another_command_is_told_with_that_command(tmp_path: Path):
    folder = two_sites(tmp_path / "S1")
    error = SolveError("a", where="b", fix="run again with --time-limit-s, or use --element tet4")
    reported = for_command_line(error, ["run", str(folder)], OPTIONS)
    assert reported.fix.endswith(f"(--element is an option of `limbcli mesh {folder}`)")
    assert for_command_line(error, ["mesh", str(folder)], OPTIONS).fix.count("--time-limit-s") == 2
    assert isinstance(reported, SolveError)


def test_message_of_a_command_line_is_pasted(tmp_path: Path, capsys):
    folder = two_sites(tmp_path / "S1")
    with pytest.raises(SystemExit):
        main(["mesh", str(folder), "--out", str(tmp_path / "out"), "--quiet"])
    shown = capsys.readouterr().err
    assert "CASE" not in shown
    assert f"limbcli segment {folder} --out {tmp_path / 'out'}" in shown


def test_a_folder_that_begins_with_a_dash_can_be_pasted(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    case = two_sites(Path("-left"))
    assert case_of(["mesh", "--", "-left"]) == case
    reported = CommandStep("mesh", "p1", {}).command(case, Path("-out"))
    assert reported == "limbcli mesh ./-left --site p1 --out ./-out"
    outcome = read_outcomes(Path("out"), ("p1",), case_name=str(case)).of("mesh", "p1")
    assert outcome.command == "limbcli mesh ./-left --site p1 --out out"
    assert pasted_text("run `limbcli segment CASE` first", case) == "run `limbcli segment ./-left` first"


@pytest.mark.parametrize("words", [["--out", "my out"], ["--out=my out"], ["-o", "my out"], ["-omy out"]])
def test_the_output_folder_is_found_however_it_is_named(words: list[str]):
    assert out_of(["mesh", "case", *words]) == Path("my out")


def test_an_option_that_is_named_with_its_command_needs_no_other():
    fix = "only `segment` and `limb --c-kpa` need none"
    error = CaseError("case.toml has no site", where="case.toml", fix=fix)
    assert for_command_line(error, ["mesh", "S1"], OPTIONS).fix == fix
