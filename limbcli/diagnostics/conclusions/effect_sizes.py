"""How large each effect could be when it alone is added: an interval for each of its sizes.

To first order at the fit without effects, the tissue refitted: eta +- 1.96 deviations, within what the
parameter's sign allows. Where the interval reaches a bound the data leave that side open.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.statistical_tests.multiple_testing import Family, Tested
from limbcli.diagnostics.statistical_tests.score import visible_columns


def sizes_95(
    state: LinearFit, family: Family, names: Mapping[str, object]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Of every candidate in the family that `names` holds: by parameter, the interval of its distance from
    the null value; infinite where the data do not tell it."""
    return {each.name: _sizes(state, each) for each in family.tests if each.name in names}


def _sizes(state: LinearFit, tested: Tested) -> dict[str, tuple[float, float]]:
    direction, eta = tested.score.direction, tested.score.eta
    A = visible_columns(state, direction)
    seen = np.linalg.norm(A, axis=0) > 0
    spread = np.full(A.shape[1], np.inf)
    if seen.any():
        inverse = np.linalg.pinv(A[:, seen].T @ A[:, seen])
        spread[seen] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return {
        name: (float(x - thresholds.SIZE_WITHIN * s), float(x + thresholds.SIZE_WITHIN * s))
        for name, x, s in zip(direction.names, eta, spread, strict=True)
    }
