"""How force and speed follow the law's exponent."""

from __future__ import annotations

from typing import Any

import numpy as np

_BEND = 8.0  # m at which the law's evenness turns into its growth


def bend(m: Any) -> Any:
    """Of m, what ln force and ln speed follow evenly: the law is even in m, an exponential of it where large.

    Polynomials in it through m 2, 5, 10 give force and speed within 0.3 % from 1 to 9; in ln m within 80 %.
    """
    return np.sqrt(_BEND**2 + np.square(m))
