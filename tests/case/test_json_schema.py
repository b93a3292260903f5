"""The JSON Schema of case.toml takes what `limbcli` takes, and marks what it refuses."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from limbcli.case import schema
from limbcli.case.imaging import SHAPE
from limbcli.case.json_schema import FILE, case_schema
from limbcli.stages.new import new

jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema, of the extra dev")
REPOSITORY = Path(__file__).resolve().parents[2]
CASES = sorted((REPOSITORY / "cases").glob("*/case.toml"))
EXAMPLES = [
    text
    for page in ("case-format.md", "fibres.md", "states.md", "instruments.md", "socket.md")
    for text in re.findall(
        r"```toml\n(.+?)```", (REPOSITORY / "docs" / page).read_text("utf-8"), flags=re.DOTALL
    )
]
WHOLE = {
    "format": 1,
    "subject": {"id": "S1", "limb": "left"},
    "imaging": {"mri": "mri"},
    "probe": {"length_mm": 53, "width_mm": 14.0},
    "site": [{"name": "p1", "position_mm": [1, 2.0, 3], "long_axis": "axial", "levels": "levels.csv"}],
}


def faults(content: dict[str, Any]) -> list[str]:
    checker = jsonschema.Draft202012Validator(case_schema())
    return [f"{each.json_path}: {each.message}" for each in checker.iter_errors(content)]


def test_it_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(case_schema())


@pytest.mark.parametrize("path", CASES, ids=lambda each: each.parent.name)
def test_every_case_is_valid(path: Path):
    assert faults(tomllib.loads(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize("text", EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_tables_of_the_documentation_are_valid(text: str):
    alone = text.startswith(("[site.", "[[site."))
    found = faults(tomllib.loads(f"[[site]]\n{text}" if alone else text))
    assert not [each for each in found if "is a required property" not in each and "any of" not in each]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: c["probe"].update(lenght_mm=53), "'lenght_mm' was unexpected"),
        (lambda c: c.update(sites=[]), "'sites' was unexpected"),
        (lambda c: c["site"][0].update(noise={"force": 0.1}), "'force' was unexpected"),
        (lambda c: c["site"][0].update(layers={"muscle": {}}), "'muscle' was unexpected"),
        (lambda c: c["probe"].update(length_mm=5300), "5300 is greater than the maximum of 150"),
        (lambda c: c["subject"].update(limb="both"), "'both' is not one of ['left', 'right']"),
        (lambda c: c["site"][0].update(long_axis="along"), "$.site[0].long_axis"),
        (lambda c: c["site"][0].update(position_mm=[1, 2]), "$.site[0].position_mm: [1, 2] is too short"),
        (lambda c: c["site"][0].pop("levels"), "$.site[0]"),
        (lambda c: c["imaging"].update(shape={"circumference": 300}), "'circumference' was unexpected"),
        (lambda c: c["imaging"].update(labels={"8": "bone"}), "$.imaging.labels"),
        (lambda c: c.update(socket={"landmarks": {"tibial_end": [0, 0]}}), "$.socket.landmarks.tibial_end"),
        (lambda c: c.update(socket={"landmarks": {"tibial_end": [0, 0, 0]}}), "$.socket.landmarks"),
        (lambda c: c.update(socket={"rectifications_mm": {"popliteal": 40}}), "40 is greater than"),
        (lambda c: c.update(socket={"liner": {"thickness_mm": 3}}), "$.socket.liner"),
        (lambda c: c.update(format=2), "1 was expected"),
        (lambda c: c.pop("probe"), "'probe' is a required property"),
    ],
)
def test_what_is_wrong_is_marked(change, expected: str):
    content = {**WHOLE, "site": [dict(WHOLE["site"][0])]}
    content |= {name: dict(content[name]) for name in ("subject", "imaging", "probe")}
    assert faults(content) == []
    change(content)
    assert any(expected in each for each in faults(content)), faults(content)


def test_every_key_has_a_type():
    tables = [value for name, value in vars(schema).items() if name.isupper() and isinstance(value, dict)]
    keys = [key for table in [*tables, SHAPE] for key in table.values() if isinstance(key, schema.Key)]
    assert len(keys) > 80
    nested = {schema.table, schema.tables, schema.label_sources}
    named = {key.check for key in keys if key.check not in nested and key.check.__name__ != "<lambda>"}
    assert not [each for each in named if each not in schema.JSON]


def test_a_new_case_names_its_schema_and_what_is_missing_is_marked(tmp_path: Path):
    new(tmp_path / "S1")
    text = (tmp_path / "S1" / "case.toml").read_text()
    assert text.startswith(f"#:schema ./{FILE}\n")
    assert (tmp_path / "S1" / FILE).is_file()
    found = faults(tomllib.loads(text))
    assert any("$.probe.length_mm: 'FILL IN' is not of type 'number'" in each for each in found)
    assert not [each for each in found if "unexpected" in each]
