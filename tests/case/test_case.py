"""case.toml: every problem at once, each with its fix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from limbcli.case import Case, read_case
from limbcli.errors import CaseError
from tests.case.test_case_text import HEAD, SITE

GOOD = HEAD + SITE.format(name="p1", levels="p1/levels.csv")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mri").mkdir()
    (tmp_path / "p1").mkdir()
    (tmp_path / "p1" / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n")
    return tmp_path


def write(folder: Path, text: str) -> Path:
    (folder / "case.toml").write_text(text)
    return folder


def whats(folder: Path) -> list[str]:
    return [each.what for each in read_case(folder)[1]]


def test_complete_case_opens_with_defaults(folder: Path):
    case = Case.open(write(folder, GOOD))
    assert case.subject == "S1"
    assert (case.probe.length, case.probe.width) == (53.0, 14.0)
    assert (case.model.margin, case.model.element) == (40.0, "tet10")
    assert case.sites[0].noise.source == "assumed"
    assert case.sites[0].density_kg_per_m3 == 1000.0
    assert case.sites[0].levels == folder / "p1" / "levels.csv"


def test_a_case_shows_itself_in_one_line(folder: Path):
    case = Case.open(write(folder, GOOD))
    assert repr(case) == f"Case({str(folder)!r}: subject S1, left limb, sites p1)"


def test_a_byte_order_mark_before_the_text_is_passed_over(folder: Path):
    write(folder, "")
    (folder / "case.toml").write_text(GOOD, encoding="utf-8-sig")
    assert Case.open(folder).subject == "S1"


def test_example_of_the_case_format_is_read_whole(folder: Path):
    text = GOOD + '[site.noise]\nforce_n = 0.2\nsource = "repeats"\n'
    noise = Case.open(write(folder, text)).sites[0].noise
    assert (noise.force, noise.depth, noise.source) == (0.2, 0.3, "repeats")


def test_every_problem_is_listed_at_once(folder: Path):
    text = (
        GOOD.replace("length_mm", "lenght_mm").replace('"left"', '"lefft"').replace("p1/levels", "p2/levels")
    )
    found = whats(write(folder, text))
    assert any("unknown key 'lenght_mm'" in each for each in found)
    assert any("limb is 'lefft'" in each and "'left'" in each for each in found)
    assert any("p2/levels.csv" in each for each in found)
    with pytest.raises(CaseError, match="problems") as caught:
        Case.open(folder)
    assert len(caught.value.facts["problems"]) == len(found)


def test_unknown_key_suggests_the_nearest(folder: Path):
    problems = read_case(write(folder, GOOD + "densty_kg_per_m3 = 1000.0\n"))[1]
    assert [each.fix for each in problems] == ["did you mean 'density_kg_per_m3'?"]
    problems = read_case(write(folder, GOOD.replace("limb = ", "side = ")))[1]
    assert "did you mean 'limb'?" in [each.fix for each in problems]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("format = 1", "format = 2", "format"),
        ("format = 1", "", "is missing 'format'"),
        ('mri = "mri"', "", "specifies no geometry"),
        ('mri = "mri"', 'mri = "nowhere"', "not found"),
        ('mri = "mri"', 'mri = "case.toml"', "is neither a folder nor a volume"),
        ("length_mm = 53.0", "length_mm = 5300", "plausible"),
        ("length_mm = 53.0", 'length_mm = "53"', "not a number"),
        ("length_mm = 53.0", "length_mm = nan", "not a number"),
        ("length_mm = 53.0", "length_mm = true", "not a number"),
        ("position_mm = [12.0, 48.5, -60.0]", "position_mm = [12.0, 48.5]", "three numbers"),
        ("position_mm = [12.0, 48.5, -60.0]", "", "neither position_mm nor marker"),
        ('long_axis = "transverse"', 'long_axis = "across"', "one of"),
        ('long_axis = "transverse"', "long_axis = [0, 0, 0]", "length zero"),
        ('name = "p1"', 'name = "../p1"', "letters"),
        ('name = "p1"', 'name = "p1-failed"', "reserved for the failure record of site 'p1'"),
        ('name = "p1"', f'name = "{"p" * 101}"', "101 letters long"),
        ('id = "S1"', "id = 7", "not text"),
        ("[probe]", "[prob]", "unknown key 'prob'"),
        ("[[site]]", "[site]", "[site] is a single table"),
        ("format = 1", "format = 1\nformat = 1", "not valid TOML"),
        (
            "length_mm = 53.0",
            "length_mm = 53,0",
            "correct that line, `length_mm = 53,0`: write a decimal point",
        ),
        ('id = "S1"', "id = \u201cS1\u201d", "straight quotes"),
        ('mri = "mri"', 'mri = "C:\\scans\\mri"', "write the path with /"),
        ('id = "S1"', "id = S1", "write text between quotes"),
        ('id = "S1"', 'id "S1"', 'correct that line, `id "S1"`'),
    ],
)
def test_wrong_case_is_refused_with_a_fix(folder: Path, old: str, new: str, expected: str):
    assert old in GOOD
    with pytest.raises(CaseError, match="fix: ") as caught:
        Case.open(write(folder, GOOD.replace(old, new)))
    assert expected in str(caught.value)


def test_position_and_marker_together_are_refused(folder: Path):
    with pytest.raises(CaseError, match="both position_mm and marker"):
        Case.open(write(folder, GOOD + "marker = 1\n"))


@pytest.mark.parametrize(
    ("table", "given"),
    [
        ('[site.load_cell]\nfile = "p1/levels.csv"\nprobe_mass_kg = 0.3\n', "no tare_s"),
        ('[site.load_cell]\nfile = "p1/levels.csv"\nseparator = "; "\n', "not a single character"),
        (
            '[site.swe_images]\nfolder = "p1"\nlow_m_per_s = 10\nhigh_m_per_s = 5\n',
            "low_m_per_s, 10, is not below high_m_per_s, 5",
        ),
        ('[site.swe_images]\nfolder = "p1"\n', "neither of high_m_per_s and high_kpa"),
        (
            '[site.swe_images]\nfolder = "p1"\nhigh_m_per_s = 10\nhigh_kpa = 300\n',
            "both of high_m_per_s and high_kpa",
        ),
        (
            '[site.swe_images]\nfolder = "p1"\nlow_m_per_s = 1\nhigh_kpa = 300\n',
            "low_m_per_s beside high_kpa",
        ),
        ('[site.swe_images]\nfolder = "p1"\nlow_kpa = 30\nhigh_kpa = 3\n', "low_kpa, 30, is not below"),
    ],
)
def test_values_of_an_instrument_that_are_at_odds_are_refused(folder: Path, table: str, given: str):
    assert any(given in each for each in whats(write(folder, GOOD + table)))


def test_two_sites_of_one_name_are_refused(folder: Path):
    site = GOOD[GOOD.index("[[site]]") :]
    with pytest.raises(CaseError, match="two sites are named 'p1'"):
        Case.open(write(folder, GOOD + site))


@pytest.mark.parametrize("other", ["P1", "p1."])
def test_sites_that_share_a_folder_on_some_file_systems_are_refused(folder: Path, other: str):
    site = GOOD[GOOD.index("[[site]]") :].replace('"p1"', f'"{other}"', 1)
    with pytest.raises(CaseError, match=f"the sites 'p1' and '{other}' share a folder"):
        Case.open(write(folder, GOOD + site))


@pytest.mark.parametrize("value", ["true", "1.0", "2", '"1"', "[1]"])
def test_only_the_whole_number_1_is_the_format(folder: Path, value: str):
    with pytest.raises(CaseError, match="this program reads format 1"):
        Case.open(write(folder, GOOD.replace("format = 1", f"format = {value}")))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("1" + 400 * "0", "64 bits"), ("-" + "9" * 5000, "not valid TOML"),
        ("[" * 2000 + "]" * 2000, "nested"),
        ("[" * 40 + "]" * 40, "nested"), (str(2**63), "64 bits"),
    ],
)  # fmt: skip
def test_numbers_and_lists_beyond_all_measure_are_a_message(folder: Path, value: str, words: str):
    for line in (f"margin_mm = {value}", f"unknown = {value}"):
        assert any(words in each for each in whats(write(folder, GOOD + f"\n[model]\n{line}\n")))


def test_missing_folder_and_missing_file_differ(tmp_path: Path):
    with pytest.raises(CaseError, match="there is no case folder"):
        Case.open(tmp_path / "nowhere")
    with pytest.raises(CaseError, match=r"contains no case\.toml"):
        Case.open(tmp_path)
    with pytest.raises(CaseError, match=f"fix:   give its folder, {re.escape(str(tmp_path))}$"):
        Case.open(write(tmp_path, GOOD) / "case.toml")


def test_unknown_site_names_the_known_ones(folder: Path):
    case = Case.open(write(folder, GOOD))
    with pytest.raises(CaseError, match="the sites are: p1"):
        case.selected(["p9"])


def test_a_site_named_twice_is_taken_once(folder: Path):
    """A likelihood that counted its readings twice would tell intervals that are too narrow."""
    case = Case.open(write(folder, GOOD))
    assert [each.name for each in case.selected(["p1", "p1"])] == ["p1"]
