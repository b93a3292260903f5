"""The decorator of compiled loops."""

import numpy as np

from limbcli.numbers.compiled import njit


@njit(cache=False)
def _ratio(a, b):
    return a / b


@njit(cache=False, forceinline=True)
def _twice(x):
    return 2.0 * x


@njit(cache=False)
def _total(values):
    total = 0.0
    for each in values:
        total += _twice(each)
    return total


def test_division_by_zero_is_that_of_numpy():
    assert _ratio(1.0, 0.0) == np.inf
    assert np.isnan(_ratio(0.0, 0.0))


def test_function_inserted_by_the_compiler_is_called_like_any_other():
    assert _total(np.arange(4.0)) == 12.0
    assert _twice(3.0) == 6.0


def test_no_wrapper_for_c_is_compiled():
    _ratio(1.0, 2.0)
    (made,) = (each for each in _ratio.overloads.values())
    names = {each.name for each in made.library.get_defined_functions()}
    assert made.fndesc.llvm_cpython_wrapper_name in names
    assert made.fndesc.llvm_cfunc_wrapper_name not in names
