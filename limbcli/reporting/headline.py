"""Headline of a parameter: its value if the data determine it, else words."""

from __future__ import annotations

from dataclasses import dataclass, replace

from limbcli.numbers.interval_limits import Flag
from limbcli.numbers.significant_digits import significant
from limbcli.reporting.numbers import interval


@dataclass(frozen=True)
class Headline:
    """A number with its unit, or words.

    is_number : whether `text` is the value or both ends of its interval, rather than one limit or words
    remark : what else is known of a value that is weakly determined
    """

    text: str
    unit: str = ""
    is_number: bool = False
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.text} {self.unit}".rstrip() + (f" ({self.remark})" if self.remark else "")


NOT_IDENTIFIABLE = Headline("not identifiable")


def headline(
    value: float | None, low: float | None, high: float | None, flag: str, *, unit: str = "", bound: str = "",
    computed: bool = True,
) -> Headline:  # fmt: skip
    """The value, shown only if the data exclude others on both sides and it is not a bound of the search;
    else words.

    low, high : 95 % interval; None where it is open
    computed : False if no interval was computed
    flag, bound : of the verdict (`inference.identifiability`)

    >>> def shown(*estimate, **more):
    ...     return str(headline(*estimate, **more))
    >>> shown(5.98, 5.5, 6.4, "identified"), shown(1000.0, 3.3, None, "at bound")
    ('5.98', 'above 3.30')
    >>> shown(3.25, None, 6.92, "weak", unit="kPa"), shown(83.0, None, None, "weak")
    ('below 6.92 kPa', 'not identifiable')
    >>> shown(83.8, 2.96, 397.0, "weak"), shown(50.0, 1.0, 90.0, "no influence")
    ('83.8 (weakly, 2.96 to 397)', 'not identifiable')
    >>> shown(150.0, None, None, "weak", computed=False)
    '150 (no interval)'
    >>> shown(1000.0, None, None, "at bound", bound="upper", computed=False)
    'at the upper bound of the search'
    """
    if value is None or flag == Flag.NO_INFLUENCE:
        return NOT_IDENTIFIABLE
    number = Headline(significant(value), unit, is_number=True)
    if flag in (Flag.IDENTIFIED, Flag.FIXED):
        return number
    if low is None and high is None:
        if computed:
            return NOT_IDENTIFIABLE
        if flag == Flag.AT_BOUND:
            return Headline(f"at the {f'{bound} ' if bound else ''}bound of the search")
        return replace(number, remark="no interval")
    ends = interval((low, high))
    if low is None or high is None:
        return Headline(ends, unit)
    if flag == Flag.AT_BOUND:
        return Headline(ends, unit, is_number=True)
    return replace(number, remark=f"{'weakly' if flag == Flag.WEAK else flag}, {ends}")
