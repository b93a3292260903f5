"""What the README promises exists."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from limbcli.case import read_case
from limbcli.cli.app import COMMANDS
from tests.cli.test_app import limbcli

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
LINES = re.findall(r"^\$ limbcli (.+?)(?:\s+#.*)?$", README, flags=re.MULTILINE)
BLOCKS = re.findall(
    r"```toml\n(.+?)```",
    README + (REPOSITORY / "docs" / "instruments.md").read_text(encoding="utf-8"),
    flags=re.DOTALL,
)


def test_every_command_of_the_table_exists():
    named = set(re.findall(r"`limbcli ([a-z-]+)", README)) | {each.split()[0] for each in LINES}
    assert named <= set(COMMANDS)


@pytest.mark.parametrize("line", LINES)
def test_options_of_every_command_line_are_known(line: str):
    name, *rest = line.split()
    text = re.sub(r"\x1b\[[0-9;]*m", "", limbcli(name, "--help").stdout)
    for option in (each for each in rest if each.startswith("--")):
        assert option in text


def test_example_case_is_valid_but_for_its_files(tmp_path: Path):
    (tmp_path / "case.toml").write_text(BLOCKS[0])
    problems = [each.what for each in read_case(tmp_path)[1]]
    assert problems
    assert all("not found" in each for each in problems)


def test_example_instruments_are_valid_but_for_their_files(tmp_path: Path):
    (tmp_path / "case.toml").write_text(BLOCKS[0] + BLOCKS[1])
    tomllib.loads(BLOCKS[0] + BLOCKS[1])
    problems = [each.what for each in read_case(tmp_path)[1]]
    assert all("not found" in each for each in problems)
