"""Formulas of loads: FEBio's grammar, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.numbers.math_expressions import Formula, FormulaError

AT, TIME = np.array([0.5, 2.0, 3.0]), 0.25


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2^3^2", 64.0),  # from left to right
        ("-2^2", -4.0),
        ("2^-1*4", 2.0),
        ("6/2/3 - 1 - 1", -1.0),
        ("1e-3*X + .5", 0.5005),
        ("log(100) + ln(e)", 3.0),
        ("|X - Y|*sgn(0)", 1.5),
        ("H(0) + step(0) + H(-1)", 1.5),
        ("max(X, Y, Z)*min(Y, t) + avg(1, 2, 6)", 3.75),
        ("pow(Y, 3) + atan2(0, -1) - pi + sinc(0)", 9.0),
        ("1.4142*(0.7071 - X*X - (Z-0.5)*(Z-0.5))", 1.4142 * (0.7071 - 0.25 - 6.25)),
    ],
)
def test_a_formula_has_febios_value(text: str, value: float) -> None:
    assert Formula(text)(AT, TIME) == pytest.approx(value, rel=1e-15)


def test_a_formula_has_a_value_at_every_point() -> None:
    points = np.random.default_rng(7).random((4, 5, 3))
    values = Formula("X*Z + t")(points, TIME)
    np.testing.assert_array_equal(values, points[..., 0] * points[..., 2] + TIME)
    assert Formula("3")(points, TIME).shape == (4, 5)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "missing"), ("X +", "missing"), ("2 X", "operator"), ("(X", "expected"), ("X)", "operator"),
        ("x", "name 'x'"), ("foo(X)", "function 'foo'"), ("sin(X, Y)", "1 value"), ("a=2;a*X", "name 'a'"),
        ("${p}", "'$'"), ("().__class__", "not expected"), ("(" * 5000 + "X" + ")" * 5000, "longer"),
        ("(" * 200 + "X" + ")" * 200, "brackets"), ("-" * 400 + "X", "signs"), ("X" * 512, "longer"),
    ],
)  # fmt: skip
def test_what_is_no_formula_is_refused_with_the_place(text: str, part: str) -> None:
    with pytest.raises(FormulaError, match=part.replace("(", "\\(").replace("$", "\\$")):
        Formula(text)


def test_a_value_that_is_none_is_told_with_its_point() -> None:
    with pytest.raises(SolveError, match=r"is inf at X, Y, Z = 0\.5, 2, 3 mm, t = 0 s"):
        Formula("X/t")(AT, 0.0)


def test_a_formula_in_other_units_has_the_same_value() -> None:
    """1 N/m^2 per metre along X, in MPa at a place in mm."""
    formula = Formula("5*X*exp(0*Z)").scaled(1000.0, 1e-6)
    assert formula(1000.0 * AT, TIME) == pytest.approx(2.5e-6, rel=1e-15)
