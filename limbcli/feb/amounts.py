"""Numbers and formulas of loads as they stand in a model file."""

from __future__ import annotations

from collections.abc import Sequence

from limbcli.feb.ids import number
from limbcli.numbers.math_expressions import Formula

Amount = float | Formula


def has_formulas(values: Sequence[Amount]) -> bool:
    return any(isinstance(each, Formula) for each in values)


def amounts(values: Sequence[Amount]) -> str:
    """Numbers, or formulas if one of them is one, separated by commas."""
    return ",".join(each.text if isinstance(each, Formula) else number(each) for each in values)


def against(values: Sequence[Amount]) -> list[Amount]:
    """The opposite of each, without negative zeros."""
    return [-each if isinstance(each, Formula) else 0.0 - each for each in values]
