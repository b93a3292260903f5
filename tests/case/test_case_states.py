"""States in case.toml: what is told is kept, and what cannot be meant has a message of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.case.parts import Stretch
from limbcli.errors import CaseError
from tests.case.test_case_text import HEAD, LEVELS

SITE = '[[site]]\nname = "p1"\nposition_mm = [12.0, 48.5, -60.0]\nlong_axis = "axial"\n'
STATES = {"relaxed": 1.0, "bent": 0.9, "stretched": 1.1}


def state(name: str, more: str = "", *, levels: str | None = None) -> str:
    return f'[[site.state]]\nname = "{name}"\nlevels = "{levels or name}.csv"\n{more}'


ALL = "".join(state(name, f"stretch_along = {value}\n") for name, value in STATES.items())


def case(folder: Path, states: str = ALL, *, site: str = SITE) -> Path:
    (folder / "mri").mkdir()
    for name in (*STATES, "levels"):
        (folder / f"{name}.csv").write_text(LEVELS)
    (folder / "case.toml").write_text(HEAD + site + states)
    return folder


def test_states_are_kept_and_the_first_is_the_sites_measurement(tmp_path: Path):
    site = Case.open(case(tmp_path)).sites[0]
    assert [each.name for each in site.states] == list(STATES)
    assert [each.stretch for each in site.states] == [Stretch(value) for value in STATES.values()]
    assert site.levels == site.states[0].levels == tmp_path / "relaxed.csv"
    assert site.unloaded == Stretch()


def test_a_stretch_may_be_unknown_by_word_or_by_silence(tmp_path: Path):
    text = state("relaxed", 'stretch_along = "unknown"\nstretch_around = 1.05\n') + state("bent")
    site = SITE + "unloaded_stretch_around = 1.02\n"
    found = Case.open(case(tmp_path, text, site=site)).sites[0]
    assert [each.stretch for each in found.states] == [Stretch(None, 1.05), Stretch()]
    assert found.unloaded == Stretch(None, 1.02)


@pytest.mark.parametrize(
    ("states", "site", "message"),
    [
        (state("relaxed"), SITE, "has only one state"),
        (ALL + state("bent", levels="levels"), SITE, "two states named 'bent'"),
        (ALL + state("other", levels="bent"), SITE, "two states with the levels of bent.csv"),
        (ALL.replace("0.9", "0.3"), SITE, "stretch_along is 0.3; plausible values are 0.5 to 2"),
        (ALL.replace("0.9", "2.5"), SITE, "stretch_along is 2.5; plausible values are 0.5 to 2"),
        (ALL.replace("0.9", "nan"), SITE, "stretch_along is nan, not a number"),
        (ALL.replace("0.9", '"short"'), SITE, "stretch_along is 'short', not a number"),
        (ALL.replace("stretch_along", "strech_along"), SITE, "did you mean 'stretch_along'?"),
        (ALL.replace("bent.csv", "gone.csv"), SITE, "names a file that was not found: gone.csv"),
        (ALL.replace('levels = "bent.csv"\n', ""), SITE, "is missing 'levels'"),
        (ALL, SITE + 'levels = "levels.csv"\n', "has its own levels as well as [[site.state]]"),
        (ALL, SITE + 'trace = "levels.csv"\n', "has trace together with [[site.state]]"),
        (ALL, SITE + 'swe_maps = "mri"\n', "has swe_maps together with [[site.state]]"),
        (ALL + '[site.load_cell]\nfile = "levels.csv"\n', SITE, "has load_cell together with [[site.state]]"),
        ("state = 3\n", SITE, "not a list of tables"),
        ("", SITE + 'levels = "levels.csv"\nunloaded_stretch_along = 1.0\n', "but no states"),
        (ALL, SITE + "unloaded_stretch_along = 3.0\n", "plausible values are 0.5 to 2"),
    ],
)
def test_what_cannot_be_meant_is_said(tmp_path: Path, states: str, site: str, message: str):
    with pytest.raises(CaseError) as raised:
        Case.open(case(tmp_path, states, site=site))
    assert message in str(raised.value) or message in str(raised.value.facts)


def test_layers_go_with_states(tmp_path: Path):
    opened = Case.open(case(tmp_path, ALL + "[site.layers.fat]\nthickness_mm = 4.0\n"))
    assert opened.sites[0].layers["fat"]["thickness_mm"] == 4.0


def test_without_states_levels_are_needed_as_ever(tmp_path: Path):
    with pytest.raises(CaseError, match=r"is missing 'levels' \(file\)"):
        Case.open(case(tmp_path, ""))
