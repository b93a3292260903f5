"""Dependence of force and speed on the law's exponent."""

from __future__ import annotations

from typing import Any

import numpy as np

_BEND = 8.0  # m around which the dependence changes from quadratic to exponential


def bend(m: Any) -> Any:
    """Transform of m in which ln force and ln speed are smooth: the law is even in m, and exponential for
    large m.

    Polynomials in it through m 2, 5, 10 give force and speed within 0.3 % from 1 to 9; in ln m within 80 %.
    """
    return np.sqrt(_BEND**2 + np.square(m))
