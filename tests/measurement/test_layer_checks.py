"""Layers in levels.csv: read where they are, and each fault told by a message of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.indentation import LayerNoise, check_levels, read_levels

HEADER = "force_n,depth_mm,skin_bone_mm,skin_mm,fat_mm,muscle_mm"
ROWS = ["0,0,30,1.5,6,22.5", "2,2,28,1.4,5.2,21.4", "4,3.5,26.5,1.4,4.7,20.4", "6,4.8,25.2,1.3,4.3,19.6"]
NOISE = LayerNoise(thickness=0.2, depth=0.3)


def write(folder: Path, rows: list[str], header: str = HEADER) -> Path:
    path = folder / "levels.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def changed(line: int, row: str) -> list[str]:
    return [row if k == line else each for k, each in enumerate(ROWS)]


def without(*names: str) -> tuple[str, list[str]]:
    """The good table with fewer columns."""
    keep = [k for k, name in enumerate(HEADER.split(",")) if name not in names]
    return ",".join(HEADER.split(",")[k] for k in keep), [
        ",".join(row.split(",")[k] for k in keep) for row in ROWS
    ]


def reported(path: Path, noise: LayerNoise | None = NOISE) -> str:
    with pytest.raises(MeasurementError, match="fix: ") as caught:
        read_levels(path, noise=noise)
    return str(caught.value)


def test_layers_are_read_and_those_not_measured_are_left_out(tmp_path: Path):
    levels = read_levels(write(tmp_path, ROWS), noise=NOISE)
    assert list(levels.layers) == ["skin", "fat", "muscle"]
    np.testing.assert_array_equal(levels.layers["fat"], [6, 5.2, 4.7, 4.3])
    header, rows = without("fat_mm", "muscle_mm", "skin_bone_mm")
    few = read_levels(write(tmp_path, rows, header), noise=NOISE)
    assert list(few.layers) == ["skin"]
    assert np.isnan(few.layer("fat")).all()
    header, rows = without("skin_mm", "fat_mm", "muscle_mm")
    assert not read_levels(write(tmp_path, rows, header)).layers


def test_good_layers_have_no_problems(tmp_path: Path):
    header, rows = without("skin_bone_mm")
    for path in (write(tmp_path, ROWS), write(tmp_path, rows, header)):
        named = [each.what for each in check_levels(path, noise=NOISE)[1]]
        assert not [text for text in named if "layer" in text or "skin" in text]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("4,3.5,26.5,1.4,4.7,17.4", "do not add up to the thickness: 1.4 + 4.7 + 17.4"),
        ("4,3.5,,1.4,-0.2,20.4", "interfaces cross: fat_mm is -0.2"),
        ("4,3.5,26.5,0,4.7,21.8", "interfaces cross: skin_mm is 0"),
        ("4,3.5,26.5,1.4,7.4,17.7", "the fat grows under load, from 6 to 7.4 mm"),
        ("4,3.5,26.5,,4.7,21.8", "has layers below the skin but no skin_mm"),
        ("4,3.5,,1400,,", "skin_mm is 1400; possible values are"),
    ],
)
def test_every_fault_has_its_own_message_with_its_line(tmp_path: Path, row, expected):
    message = reported(write(tmp_path, changed(2, row)))
    assert expected in message
    assert "line 4" in message
    faults = ("add up", "cross", "grows", "no skin_mm", "possible values are")
    assert len([word for word in faults if word in message]) == 1


def test_layers_without_skin_are_refused(tmp_path: Path):
    header, rows = without("skin_mm")
    assert "layers without skin: fat_mm and muscle_mm" in reported(write(tmp_path, rows, header))


def test_without_a_bone_distance_the_sum_is_held_against_the_depth(tmp_path: Path):
    header, rows = without("skin_bone_mm")
    rows[3] = "6,4.8,1.3,4.3,22"
    assert "minus depth_mm leaves 25.2 mm" in reported(write(tmp_path, rows, header))


def test_layers_that_end_beyond_the_bone_cross_it(tmp_path: Path):
    header, rows = without("muscle_mm")
    rows[3] = "6,4.8,5,1.3,5.3"
    message = reported(write(tmp_path, rows, header))
    assert "the layers end 6.6 mm below the skin, beyond the bone at 5 mm" in message


def test_growth_is_judged_by_the_stated_noise(tmp_path: Path):
    path = write(tmp_path, changed(1, "2,2,28,1.4,7.3,19.3"))
    assert "grows under load" in reported(path)
    read_levels(path, noise=LayerNoise(thickness=0.2 * 1.3))
    read_levels(path)  # nobody states a noise


def test_layers_that_begin_after_first_touch_are_shown_but_not_used(tmp_path: Path):
    levels, problems = check_levels(write(tmp_path, changed(0, "0,0,30,,,")), noise=NOISE)
    assert levels is not None
    warned = [each for each in problems if "at first touch" in each.what]
    assert [each.severity for each in warned] == ["warning"]
