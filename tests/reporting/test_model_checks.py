"""The table of what other boundaries and a stiffer contact change."""

from __future__ import annotations

from limbcli.reporting.sections.model_checks import model_check_tables, noise_alone

FOUND = {
    "boundary_check": {
        "cut_free": {"depths_mm": [2.0, 4.0], "force_change_fraction": [-0.01, -0.097], "f_kappa": 140.0},
        "far_side_held": {"not_evaluated": "a fold of the skin"},
    },
    "contact_check": {"penalty": 20.0, "tried": 80.0, "force_change_fraction": [0.002, 0.03]},
    "interval_95_noise": {"f_kappa": [60.0, None], "m": [4.0, 5.0]},
}


def test_every_change_of_the_model_has_its_row():
    (table,) = model_check_tables("p1", FOUND)
    shown = [[cell.text for cell in row] for row in table.rows]
    assert shown == [
        ["cut plane free, not held", "-9.7 to -1.0 %", "140", "–"],
        ["far side held, not free", "–"],
        ["contact 4 times as stiff", "+0.2 to +3.0 %", "–", "–"],
    ]
    assert table.rows[1][1].reason == "a fold of the skin"


def test_a_fit_without_checks_has_no_table():
    assert model_check_tables("p1", {}) == ()
    assert noise_alone({}) == ""


def test_intervals_of_noise_alone_are_said():
    assert noise_alone(FOUND) == "with noise and mesh alone, 95 %: f_κ above 60.0, m 4.00 to 5.00"
