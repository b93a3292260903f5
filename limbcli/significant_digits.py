"""Format numbers for text: only significant digits, and no exponent where digits suffice."""

from __future__ import annotations


def short(value: float, digits: int = 3) -> str:
    """At most `digits` significant digits, but all digits before the decimal point.

    >>> short(0.05234, 2), short(5.0, 2), short(99.6, 2), short(1234.5, 2), short(-340.0, 2)
    ('0.052', '5', '100', '1234', '-340')
    """
    shown = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in shown else shown
