"""Error of an effect's own form: no model of fat, fibres or a scar matches the limb exactly.

Its standard deviation is a fraction of the change by the effect, correlated between neighbouring levels and,
in images, over some millimetres: edges are displaced. All sizes are assumed.
"""

from __future__ import annotations

import numpy as np

from limbcli.diagnosis.explanations.model.forward_model import Data, Fitted
from limbcli.diagnosis.explanations.model.noise import correlated
from limbcli.model import Array

_SHARE, _ALIKE = 0.05, 0.8  # of the change of forces and mean speeds; correlation between neighbouring levels
_IN_IMAGE, _WIDE_MM, _ALIKE_IN_IMAGE = 0.15, 4.0, 0.97  # the same in an image, and its correlation length


def form_error(data: Data, fitted: Fitted) -> Array | None:
    """Covariance (n, n); None without such effects."""
    if fitted.without is None:
        return None
    change = np.abs(fitted.prediction - fitted.without)
    total = np.zeros((len(data), len(data)))
    for mask in data.channels().values():
        own = np.where(mask, change, 0.0)
        if np.all(data.imaged[mask]):
            total += _in_image(data, _IN_IMAGE * own)
        else:
            total += correlated(
                "form", _SHARE * own, data.order, correlation=_ALIKE, source="assumed"
            ).covariance
    return total


def _in_image(data: Data, size: Array) -> Array:
    """Covariance (n, n) of errors with this standard deviation (n,) in one channel's images."""
    assert data.place is not None
    x, z = np.nan_to_num(data.place).T
    apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(z, z))
    alike = _ALIKE_IN_IMAGE ** np.abs(np.subtract.outer(data.order, data.order))
    return np.asarray(np.exp(-0.5 * (apart / _WIDE_MM) ** 2) * alike * np.outer(size, size))
