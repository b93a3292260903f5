"""`limbcli fit`: what it refuses, with exit code and fix."""

import json
from pathlib import Path

import pytest

from limbcli.cli.app import main
from tests.case.test_case_text import ONE_SITE


@pytest.fixture
def case(tmp_path: Path) -> Path:
    (tmp_path / "mri").mkdir()
    (tmp_path / "levels.csv").write_text("force_n,depth_mm\n0,0\n2,1\n4,2\n6,3\n")
    (tmp_path / "case.toml").write_text(ONE_SITE)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "code", "fix"),
    [
        (["--c-kpa", "nan"], 2, "finite number"),
        (["--c-kpa", "1e999"], 2, "finite number"),
        (["--c-kpa", "8000"], 2, "kPa"),
        (["--tolerance", "0"], 2, "1e-3"),
        (["--c-deviation-fraction", "-1"], 2, "share of c"),
        (["--objective", "joint", "--gain-deviation-fraction", "nan"], 2, "finite number"),
        (["--gain-deviation-fraction", "-1"], 2, "share of the force"),
        (["--gain-deviation-fraction", "5", "--objective", "joint"], 2, "share of the force"),
        (["--gain-deviation-fraction", "0.1", "--compare-element"], 2, "omit it"),
        (["--no-intervals", "--compare-element"], 2, "omit it"),
        (["--compare-element", "--febio", "febio4"], 2, "omit --febio"),
        (["--max-iterations", "1", "--objective", "joint"], 2, "--objective force"),
        (["--templates", "nowhere", "--objective", "joint"], 2, "omit it"),
        (["--c-kpa", "8", "--objective", "states"], 2, "omit it"),
        (["--cycle", "2", "--objective", "states"], 2, "omit it"),
        (["--objective", "joint", "--compare-element"], 2, "one at a time"),
        (["--objective", "joint", "--stiffness-map"], 2, "or the map"),
        (["--compare-laws"], 2, "--objective joint"),
        (["--law", "holmes-mow"], 2, "--objective joint"),
        ([], 2, "limbcli build-feb"),
        (["--site", "p9"], 2, "the sites are: p1"),
        (["--objective", "both"], 2, "use force, joint or states"),
        (["--objective", "joint", "--solver", "febio"], 2, "reference solver supports it"),
        (["--objective", "joint", "--law", "mooney"], 2, "mooney-rivlin"),
        (["--compare-element", "--solver", "febio"], 2, "omit --solver"),
        (["--objective", "joint"], 2, "limbcli build-feb"),
        (["--compare-element"], 2, "limbcli build-feb"),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_fix(case: Path, capsys, arguments, code, fix):
    with pytest.raises(SystemExit) as stopped:
        main(["fit", str(case), "--out", str(case / "out"), "--quiet", *arguments])
    assert stopped.value.code == code
    reported = capsys.readouterr().err
    assert fix in reported
    assert "Traceback" not in reported
    assert not list((case / "out").rglob("fit*.json"))


def test_an_error_is_told_as_json_too(case: Path, capsys):
    with pytest.raises(SystemExit):
        main(["fit", str(case), "--out", str(case / "out"), "--json", "--objective", "both"])
    content = json.loads(capsys.readouterr().out)
    assert content["error"] == "CaseError"
    assert content["exit_code"] == 2
