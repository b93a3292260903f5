"""Headline of a parameter: its value if the data determine it, else words."""

from __future__ import annotations

from limbcli.reporting.numbers import significant

NOT_IDENTIFIABLE = "not identifiable"
_SOUND = ("identified", "fixed")
_NO_INFLUENCE, _AT_BOUND = "no influence", "at bound"


def headline(
    value: float | None,
    low: float | None,
    high: float | None,
    flag: str,
    *,
    unit: str = "",
    why: str = "",
    computed: bool = True,
) -> str:
    """The value, shown only if the data exclude others on both sides and it is not a bound of the search;
    else words.

    low, high : 95 % interval; None where it is open
    computed : False if no interval was computed
    flag : flag of the verdict (`inference.identifiability`)
    why : its sentence, which names the bound

    >>> headline(5.98, 5.5, 6.4, "identified"), headline(1000.0, 3.3, None, "at bound")
    ('5.98', 'above 3.30')
    >>> headline(3.25, None, 6.92, "weak", unit="kPa"), headline(83.0, None, None, "weak")
    ('below 6.92 kPa', 'not identifiable')
    >>> headline(83.8, 2.96, 397.0, "weak"), headline(50.0, 1.0, 90.0, "no influence")
    ('83.8 (weakly, 2.96 to 397)', 'not identifiable')
    >>> headline(150.0, None, None, "weak", computed=False)
    '150 (no interval)'
    """
    tail = f" {unit}" if unit else ""
    if value is None or flag == _NO_INFLUENCE:
        return NOT_IDENTIFIABLE
    if flag in _SOUND:
        return f"{significant(value)}{tail}"
    if low is None and high is None:
        if computed:
            return NOT_IDENTIFIABLE
        return _bound(why) if flag == _AT_BOUND else f"{significant(value)}{tail} (no interval)"
    if high is None:
        return f"above {significant(low or 0.0)}{tail}"
    if low is None:
        return f"below {significant(high)}{tail}"
    ends = f"{significant(low)} to {significant(high)}"
    if flag == _AT_BOUND:
        return f"{ends}{tail}"
    word = "weakly" if flag == "weak" else flag
    return f"{significant(value)}{tail} ({word}, {ends})"


def _bound(why: str) -> str:
    """
    >>> _bound("f_kappa ended on its upper bound 1000; no interval was requested.")
    'at the upper bound of the search'
    """
    side = next((each for each in ("lower ", "upper ") if f"{each}bound" in why), "")
    return f"at the {side}bound of the search"
