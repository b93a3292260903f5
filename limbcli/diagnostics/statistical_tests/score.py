"""Score tests: how much of the residual one additional effect would explain, to first order.

A `Direction` holds the whitened sensitivities H of an effect at its null value. A `Trial` is an effect
with one direction per point of its grid (a relaxation time, a place), and its statistic is the largest
over its directions. Parameters with a fixed sign restrict the explanation to a cone; the statistic is
the squared length of the residual's projection onto this cone.

Source: Silvapulle & Sen 2005, Constrained Statistical Inference, sections 3.3 and 4.3
(one-sided score tests); Davies 1987, Biometrika 74:33 (parameters present only off the null).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.model import Array

_INVISIBLE = 1e-6
RCOND = 1e-7


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect (or a group of data) to be tested; its statistic is the largest over its directions."""

    name: str
    directions: tuple[Direction, ...]


@dataclass(frozen=True, eq=False)
class Score:
    """A test statistic, the direction it was found in, and the first-order estimate eta (q,) there."""

    statistic: float
    direction: Direction
    eta: Array


def visible_columns(state: LinearFit, direction: Direction) -> Array:
    """A = P H (n, q); columns that the fitted parameters can reproduce completely are set to zero."""
    A = state.project(direction.columns)
    size, full = np.linalg.norm(A, axis=0), np.linalg.norm(direction.columns, axis=0)
    A[:, size <= _INVISIBLE * np.maximum(full, 1e-300)] = 0.0
    return A


def cone_projection(A: Array, signs: tuple[int, ...], draws: Array) -> tuple[Array, Array]:
    """Squared length of each draw's projection onto the cone A eta, and eta.

    Parameters
    ----------
    A : (n, q); signs : (q,); draws : (n_draws, n)

    Returns
    -------
    (n_draws,), (n_draws, q)

    The projection onto a polyhedral cone equals the projection onto the span of one of its faces: the longest
    among the faces whose solution satisfies the sign constraints.

    >>> cone_projection(np.array([[1.0], [0.0]]), (1,), np.array([[2.0, 5.0], [-2.0, 5.0]]))[0]
    array([4., 0.])
    """
    q = A.shape[1]
    best, eta = np.zeros(len(draws)), np.zeros((len(draws), q))
    if not np.any(A):
        return best, eta
    free = [k for k in range(q) if signs[k] == 0]
    bound = [k for k in range(q) if signs[k] != 0]
    if not bound:
        return _span_projection(A, draws)
    sign = np.array(signs, dtype=float)
    for size in range(len(bound) + 1):
        for chosen in itertools.combinations(bound, size):
            active = [*free, *chosen]
            if not active:
                continue
            solved = draws @ np.linalg.pinv(A[:, active], rcond=RCOND).T
            value = np.einsum("bi,bi->b", solved @ A[:, active].T, draws)
            held = list(chosen)
            keeps = np.ones(len(draws), dtype=bool)
            if held:
                inside = solved[:, len(free) :] * sign[held]
                keeps = np.all(inside >= 0.0, axis=1)
            better = keeps & (value > best)
            best[better] = value[better]
            eta[better] = 0.0
            eta[np.ix_(better, active)] = solved[better]
    return best, eta


def _span_projection(A: Array, draws: Array) -> tuple[Array, Array]:
    """The same for the whole span of A, without sign constraints."""
    u, s, vt = np.linalg.svd(A, full_matrices=False)
    kept = s > RCOND * s[0]
    inside = draws @ u[:, kept]
    return np.einsum("bi,bi->b", inside, inside), (inside / s[kept]) @ vt[kept]


def narrowed(state: LinearFit, trial: Trial, n: int = 2) -> Trial:
    """The trial restricted to the `n` directions that explain most of the residual."""
    if len(trial.directions) <= n:
        return trial
    left = state.left[None]
    value = [
        float(cone_projection(visible_columns(state, each), each.signs, left)[0][0])
        for each in trial.directions
    ]
    best = np.argsort(value)[::-1][:n]
    return Trial(trial.name, tuple(trial.directions[k] for k in best))


def statistics(state: LinearFit, trial: Trial, draws: Array) -> Array:
    """(n_draws,) of the trial's statistic; draws (n_draws, n) already projected by P."""
    found = np.zeros(len(draws))
    for direction in trial.directions:
        value, _ = cone_projection(visible_columns(state, direction), direction.signs, draws)
        found = np.maximum(found, value)
    return found


def scores(state: LinearFit, trial: Trial) -> list[Score]:
    """The score of the actual residual in each of the trial's directions."""
    left, found = state.left[None], []
    for direction in trial.directions:
        value, eta = cone_projection(visible_columns(state, direction), direction.signs, left)
        found.append(Score(float(value[0]), direction, eta[0]))
    return found


def score(state: LinearFit, trial: Trial) -> Score:
    """The largest score over the trial's directions."""
    return max(scores(state, trial), key=lambda each: each.statistic)


def cosine(state: LinearFit, first: Direction, second: Direction) -> float:
    """Largest cosine between the spans of two directions, projected off the fitted parameters.

    Near 1, the two effects cannot be distinguished in these data.
    """
    bases = []
    for direction in (first, second):
        A = visible_columns(state, direction)
        u, s, _ = np.linalg.svd(A, full_matrices=False)
        bases.append(u[:, s > RCOND * max(float(s[0]), 1e-300)] if s.size and s[0] > 0 else u[:, :0])
    if not bases[0].shape[1] or not bases[1].shape[1]:
        return 0.0
    if bases[0].shape[1] == bases[1].shape[1] == 1 and first.signs == second.signs == (1,):
        return float(bases[0][:, 0] @ bases[1][:, 0] * _orientation(state, first, second, bases))
    return float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0])


def _orientation(state: LinearFit, first: Direction, second: Direction, bases: list[Array]) -> float:
    """Sign that restores the orientation of the columns after the singular value decomposition."""
    a = visible_columns(state, first)[:, 0] @ bases[0][:, 0]
    b = visible_columns(state, second)[:, 0] @ bases[1][:, 0]
    return float(np.sign(a) * np.sign(b))
