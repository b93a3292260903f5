"""Good, doubtful or bad: the verdict on twenty fits, and that every reader shows the same."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.inference.agreement import (
    chi_square_agreement,
    force_agreement,
    speed_agreement,
    tissue_agreement,
)
from limbcli.reporting.agreement_view import agreement_view

ZIGZAG = np.array([1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0])  # in noise deviations
BOW = np.array([-1.2, -1.1, -0.8, -0.3, 0.5, 0.9, 1.4, 1.2, 0.7, 0.2])  # one change of sign
SMOOTH = np.array([0.01, -0.02, 0.01, 0.02, -0.01, -0.02, 0.01, -0.01])
RISING = np.linspace(2.3, 3.0, 5)  # m/s


def force(shape: np.ndarray, *, noise: float = 0.5, r2: float = 0.99, free: int = 2, likelihood=None):
    deviation = np.full(len(shape), noise)
    return force_agreement(shape * 0.5, deviation, r2, n_free=free, likelihood=likelihood)


def speeds(factor: float | np.ndarray, *, level: float = 0.05, c: float = 0.1):
    return speed_agreement(factor * RISING, RISING, level_fraction=level, c_deviation=c)


FITS = {
    "scatter as large as the noise": (force(ZIGZAG), "good"),
    "differences of half the noise": (force(0.6 * ZIGZAG), "good"),
    "1.5 times the noise": (force(1.5 * ZIGZAG), "doubtful"),
    "2.5 times the noise": (force(2.5 * ZIGZAG), "bad"),
    "levels too stiff: all one sign, far off": (force(4.0 * np.abs(ZIGZAG)), "bad"),
    "wrong zero of depth: a drift beyond the noise": (force(2.0 * BOW), "bad"),
    "a drift within the noise": (force(BOW), "doubtful"),
    "a drift far within the noise": (force(0.45 * BOW), "good"),
    "levels too smooth: chi2/nu of 0.0001": (force(SMOOTH), "doubtful"),
    "R2 below 0.9 with wide noise": (force(ZIGZAG, r2=0.7), "bad"),
    "no noise stated": (force(ZIGZAG, noise=0.0), "untested"),
    "no noise stated and R2 of 0.5": (force(ZIGZAG, noise=0.0, r2=0.5), "bad"),
    "as many parameters as levels": (force(ZIGZAG[:2]), "untested"),
    "an error of c explains the offset": (force(1.8 * ZIGZAG, likelihood=(5.0, 6)), "good"),
    "an error of c explains it in part": (force(1.8 * ZIGZAG, likelihood=(14.0, 6)), "doubtful"),
    "speeds as predicted": (speeds(1.02), "good"),
    "speeds 9 % too fast together, as c may be": (speeds(1.09), "good"),
    "speeds 23 % too slow": (speeds(0.77, c=0.05), "bad"),
    "speeds that rise too fast": (speeds(np.linspace(1.0, 1.3, 5)), "bad"),
    "speeds without noise": (speeds(1.3, level=0.0), "untested"),
    "a joint fit near its degrees of freedom": (chi_square_agreement(12.0, 10), "good"),
    "a joint fit at 10 per degree of freedom": (chi_square_agreement(30.0, 3), "bad"),
    "a joint fit at 0.01 per degree of freedom": (chi_square_agreement(0.1, 10), "doubtful"),
}


@pytest.mark.parametrize("name", FITS)
def test_the_verdict_on_each_kind_of_fit(name):
    found, expected = FITS[name]
    assert found.state == expected, found.words


@pytest.mark.parametrize("name", [name for name, (_, state) in FITS.items() if state in ("doubtful", "bad")])
def test_no_verdict_against_a_fit_without_its_number(name):
    words = FITS[name][0].words
    assert any(each in words for each in ("chi2/nu", "times the counted noise", "R2 0.")), words


def test_how_well_a_fit_agrees_is_said():
    said = {
        "scatter as large as the noise": "agrees:",
        "1.5 times the noise": "agrees poorly:",
        "levels too smooth: chi2/nu of 0.0001": "agrees too well:",
        "a drift within the noise": "agrees:",
    }
    for name, words in said.items():
        assert FITS[name][0].words.startswith(f"the force {words}")
    assert FITS["a joint fit near its degrees of freedom"][0].words.startswith("the fit agrees with the data")


def test_too_close_and_the_shape_of_a_drift_are_said():
    assert "closer than the counted noise allows" in FITS["levels too smooth: chi2/nu of 0.0001"][0].words
    assert [name for name, (found, *_) in FITS.items() if found.too_close] == [
        name for name, (found, *_) in FITS.items() if "closer than the counted noise allows" in found.words
    ]
    assert "change sign only once" in FITS["a drift within the noise"][0].words


@pytest.mark.parametrize("name", FITS)
def test_the_page_shows_the_state_of_the_result(name):
    found, state = FITS[name]
    told = {"agreement": {"state": found.state, "force": vars(found)}}
    view = agreement_view(told, "force")
    assert (view.state, view.words) == (found.state, found.words)
    assert (view.mood == "fine") == (state == "good"), "green only where a test has said so"


@pytest.mark.parametrize(("below", "is_bad"), [(0.5, True), (1.95, True), (2.5, False), (50.0, False)])
def test_forces_that_no_soft_tissue_of_this_speed_gives_are_bad(below: float, is_bad: bool):
    """Forces in lbf, read as N, fit well with f_kappa near 0."""
    found = tissue_agreement(below, [])
    assert (found is not None and found.state == "bad" and "lbf" in found.words) == is_bad


def test_the_page_says_first_what_contradicts_itself():
    tissue = tissue_agreement(1.0, ["f_kappa"])
    assert tissue is not None
    good = vars(force(ZIGZAG))
    view = agreement_view({"agreement": {"state": "bad", "force": good, "tissue": vars(tissue)}})
    assert view.words == tissue.words
