"""`@njit`: numba's decorator with the options that all compiled loops of the package share.

With the same options everywhere, numba compiles each of its own functions (`np.empty`, `max`, ...) once per
type of argument, not once more for every set of options. A division by zero gives inf or nan, as in numpy:
branches that raise would have to be compiled too. No loop is a callback of C code, which would need another
wrapper around each.
"""

from __future__ import annotations

from typing import Any

import numba

_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def njit(function: Any = None, /, **further: Any) -> Any:
    """Compile a function at its first call and cache it on disk; takes further options of `numba.njit`.

    For a small function called in loops, `forceinline=True` has the compiler insert it; numba's own
    `inline="always"` would type and lower its statements again at every call.

    >>> @njit(cache=False)
    ... def half(x):
    ...     return 0.5 * x
    >>> half(3.0)
    1.5
    """
    decorate = numba.njit(**(_OPTIONS | further))
    return decorate if function is None else decorate(function)
