"""The page of a cohort says how many stand out, and when a list is not all of them."""

from __future__ import annotations

import pytest

from limbcli.cohorts.sections import grounds, standing_out


@pytest.mark.parametrize(("fat", "word"), [(True, "taken from the others"), (False, "assumed")])
def test_noise_that_no_layer_tells_is_called_assumed(fat, word):
    layers = ("skin", "fat", "muscle")
    noise = {
        "layer_shortened_mm": dict.fromkeys(layers, 0.2),
        "from_data": {"skin": False, "fat": fat, "muscle": False},
        "ln_stiffness": 0.05,
        "ln_stiffness_from_data": False,
    }
    emulator = {
        "n_solves": 1, "n_solves_on_finer_mesh": 0,
        "left_out_error": {"force_percent": 7.0, "logit_muscle_part": 0.1},
    }  # fmt: skip
    (table,) = grounds({"noise": noise, "emulator": emulator}).tables
    told = {row[0].text: row[2].text for row in table.rows}
    assert told["noise of the skin’s shortening"] == told["noise of the muscle’s shortening"] == word
    assert told["noise of the fat’s shortening"] == ("from this table" if fat else word)


def test_a_list_that_is_cut_says_so_and_one_is_one():
    row = {"subject": "A", "location": "thigh", "line": 3, "p_adjusted": 0.01}
    person = {"subject": "A", "n_rows": 2, "muscle": "stiffer", "z": 4.1, "p_adjusted": 1e-7}
    shown = standing_out({"stands_out": {"level": 0.05, "rows": [row] * 40, "people": [person]}})
    people, rows = shown.tables
    assert len(rows.rows) == 25
    assert rows.caption.endswith(", the first 25 of 40")
    assert people.rows[0][-1].text == "1.0e-7"
    assert "of 1" not in people.caption
    assert shown.notes == ("40 rows and 1 person stand out at 5 %, adjusted for all looked at (Holm).",)
