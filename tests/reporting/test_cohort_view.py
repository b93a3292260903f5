"""The page of a cohort says how many stand out, and when a list is not all of them."""

from __future__ import annotations

from limbcli.reporting.cohort_view import standing_out


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
