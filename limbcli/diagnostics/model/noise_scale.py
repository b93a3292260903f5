"""How large an assumed error is, from the data themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize_scalar

from limbcli.diagnostics.model.noise import Noise
from limbcli.model import Array, IntArray

_EXACT = 0.01  # of ln share


def likeliest_share(residual: Array, jacobian: Array, noise: Noise, name: str, *, least: float) -> float:
    """Times what is assumed of the noise part `name`, from `least` to 1, that makes a residual likeliest.

    residual (n,) of a fit with sensitivities jacobian (n, p). An effect that the model lacks makes the
    residual larger: an error is then allowed for that is too large, at most the one assumed.
    1 where there is no such part, or nothing in it.

    Source: restricted likelihood, Patterson & Thompson 1971, Biometrika 58:545.
    """
    part = next((each.covariance for each in noise.parts if each.name == name), None)
    if part is None or not part.any():
        return 1.0
    others = noise.covariance - part
    columns = _unit(jacobian)

    def cost(log_share: float) -> float:
        return _restricted(residual, columns, others + np.exp(2 * log_share) * part)

    low = float(np.log(least))
    found = minimize_scalar(cost, bounds=(low, 0.0), method="bounded", options={"xatol": _EXACT})
    ends = {float(found.x): float(found.fun), low: cost(low), 0.0: cost(0.0)}
    return float(np.exp(min(ends, key=lambda at: ends[at])))


def likeliest_factors(
    residual: Array, jacobian: Array, noise: Noise, name: str, groups: Sequence[str], *, gain: float
) -> Array:
    """Times what is assumed of the noise part `name` (n,), from 0 to 1 by groups of the data, that makes a
    residual likeliest.

    residual, jacobian : as in `likeliest_share`; groups (n,) : of each datum, the one it is in; the part must
    not tie data of several groups. 0 but for those by which the restricted ln likelihood grows by `gain` at
    least, one after the other, the largest gain first.
    """
    found = np.zeros(len(residual))
    part = next((each.covariance for each in noise.parts if each.name == name), None)
    if part is None or not part.any():
        return found
    covariance, columns = noise.covariance - part, _unit(jacobian)
    has = np.diag(part) > 0
    left = [np.flatnonzero(has & (np.array(groups) == group)) for group in dict.fromkeys(groups)]
    left = [at for at in left if len(at)]
    while left:
        inverse = np.linalg.inv(covariance)
        seen = inverse @ columns
        free = inverse - seen @ np.linalg.pinv(columns.T @ seen) @ seen.T
        steps = [_best_factor(residual, free, part, at) for at in left]
        best = int(np.argmax([grown for grown, _ in steps]))
        grown, factor = steps[best]
        if grown < gain:
            break
        at = left.pop(best)
        found[at] = factor
        covariance[np.ix_(at, at)] += factor**2 * part[np.ix_(at, at)]
    return found


def _best_factor(residual: Array, free: Array, part: Array, at: IntArray) -> tuple[float, float]:
    """By how much the restricted ln likelihood grows at most where the part is added at these data alone, and
    times what.

    With P, `free`, the inverse of the covariance but for what columns fit, and K the part there, it grows by
    the sum of (f^2 w_i^2 / (1 + f^2 s_i) - ln(1 + f^2 s_i)) / 2 over the eigenvalues s_i of L' P L, where
    K = L L' and w are the components of L' P r along its eigenvectors (matrix determinant lemma).
    """
    values, vectors = np.linalg.eigh(part[np.ix_(at, at)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    s, along = np.linalg.eigh(root.T @ free[np.ix_(at, at)] @ root)
    s, w = np.maximum(s, 0.0), along.T @ root.T @ (free[at] @ residual)

    def loss(f: float) -> float:
        return -0.5 * float(np.sum(f**2 * w**2 / (1 + f**2 * s) - np.log1p(f**2 * s)))

    best = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 0.1 * _EXACT})
    return -float(best.fun), float(best.x)


def _unit(jacobian: Array) -> Array:
    """Its columns that are not nothing, each of length 1."""
    lengths = np.linalg.norm(jacobian, axis=0)
    return np.asarray(jacobian[:, lengths > 0] / lengths[lengths > 0])


def _restricted(residual: Array, columns: Array, covariance: Array) -> float:
    """Minus the restricted log likelihood, but for a constant."""
    factor = cholesky(covariance, lower=True)
    off = solve_triangular(factor, residual, lower=True)
    basis, upper = np.linalg.qr(solve_triangular(factor, columns, lower=True))
    left = off - basis @ (basis.T @ off)
    sizes = np.abs(np.concatenate([np.diag(factor), np.diag(upper)]))
    return float(0.5 * left @ left + np.log(np.maximum(sizes, 1e-300)).sum())
