"""Format numbers for text: only significant digits, and no exponent where digits suffice."""

from __future__ import annotations

import math

_SMALLEST_EXPONENT = -4


def significant(value: float, digits: int = 3) -> str:
    """A number of `digits` significant digits, also those that are 0; but all before the decimal point.

    >>> significant(5.2034), significant(104.4), significant(0.01234), significant(12345.0), significant(0)
    ('5.20', '104', '0.0123', '12345', '0')
    >>> significant(1.0), significant(0.9999), significant(99.96), significant(-0.1), significant(3.21e-7)
    ('1.00', '1.00', '100', '-0.100', '3.21e-7')
    """
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else f"{value}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if int(exponent) < _SMALLEST_EXPONENT:
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.{max(digits - 1 - int(exponent), 0)}f}"


def short(value: float, digits: int = 3) -> str:
    """The same without zeros at the end of the decimals.

    >>> short(0.05234, 2), short(5.0, 2), short(99.6, 2), short(1234.5, 2), short(-340.0, 2), short(2e-7)
    ('0.052', '5', '100', '1234', '-340', '2e-7')
    """
    digit, e, exponent = significant(value, digits).partition("e")
    return (digit.rstrip("0").rstrip(".") if "." in digit else digit) + e + exponent
