"""The table [socket] of case.toml: what it takes, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from limbcli.case.reading import CaseReading
from limbcli.case.socket import read_socket


def read(folder: Path, **table: Any):
    (folder / "socket.stl").touch()
    reading = CaseReading(folder)
    return read_socket({"socket": table}, reading), reading.problems


def test_an_empty_table_is_a_socket_of_the_skins_shape(tmp_path: Path):
    found, problems = read(tmp_path)
    assert not problems
    assert found is not None
    assert (found.surface, found.friction, found.loads) == (None, 0.3, (400.0, 800.0))


def test_a_liner_and_a_load_at_the_knee_are_in_internal_units(tmp_path: Path):
    liner, knee = {"thickness_mm": 6.0, "youngs_modulus_kpa": 400.0}, {"about_lateral_n_m": 12.0}
    found, problems = read(tmp_path, liner=liner, knee=knee)
    assert not problems
    assert found is not None
    assert found.liner is not None
    assert found.knee is not None
    assert (found.liner.youngs_modulus, found.liner.poisson) == (0.4, 0.45)
    assert (found.knee.about_lateral, found.knee.anterior, found.knee.centre) == (12_000.0, 0.0, None)


def test_a_case_without_the_table_has_no_socket(tmp_path: Path):
    reading = CaseReading(tmp_path)
    assert (read_socket({}, reading), reading.problems) == (None, [])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"surface": "none.stl"}, "was not found"),
        ({"liner": {"thickness_mm": 3.0}}, "missing 'youngs_modulus_kpa'"),
        (
            {"liner": {"thickness_mm": 3.0, "youngs_modulus_kpa": 300.0, "friction": 0.2}},
            "to which the liner is bonded",
        ),
        ({"liner": {"thickness_mm": 60.0, "youngs_modulus_kpa": 300.0}}, "thickness_mm is 60"),
        ({"knee": {"anterior_n": 9000.0}}, "anterior_n is 9000"),
        ({"knee": {"centre_mm": [0, 0]}}, "not three numbers"),
        ({"align": True}, "has align but no surface"),
        ({"surface": "socket.stl", "rectifications_mm": {"popliteal": 2.0}}, "surface and rectifications_mm"),
        ({"surface": "socket.stl", "align": True, "landmarks": {n: [0, 0, 0] for n in "abc"}}, "two ways"),
        ({"surface": "socket.stl", "landmarks": {"tibial_end": [0, 0, 0]}}, "has 1 of the 3"),
        ({"surface": "socket.stl", "landmarks": {"tibial_end": [0, 0]}}, "not three numbers"),
        ({"loads_n": [800.0, 400.0]}, "has 400 N after 800 N"),
        ({"loads_n": [400.0, 400.0]}, "has 400 N after 400 N"),
        ({"loads_n": [400.0, -1.0]}, "has -1 N, which lifts the limb out"),
        ({"rectifications_mm": {"popliteal": 40.0}}, "popliteal is 40 mm"),
        ({"frction": 0.2}, "unknown key 'frction'"),
    ],
)
def test_what_cannot_be_used_has_its_own_message(tmp_path: Path, table: dict[str, Any], words: str):
    found, problems = read(tmp_path, **table)
    assert found is None
    assert any(words in each.what for each in problems), [each.what for each in problems]
    assert all(each.fix for each in problems)
