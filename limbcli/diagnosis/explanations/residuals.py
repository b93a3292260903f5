"""What residuals show beside the evidence: a predictive check, scatter, held-out data, a jump of the cell.

The posterior predictive check asks whether the residual of an explanation is one that its noise gives, as a
whole and in parts. The tests of the whole residual (chi2) and of every part of the data (a channel, a third
of the levels, a region of the maps) form one family; their p are adjusted by the smallest p in draws from the
noise. The size of the model's error in a region of an image is known only roughly: the draws of such a part
have a variance of their own.

The scatter about smooth curves checks the stated noise; cross-validation shows whether an explanation
predicts data that it was not fitted to. A cell that is tared anew (or slips) while the probe rests on the
limb adds one number to all later forces, an error of the measurement that can resemble an effect.

Source: Westfall & Young 1993, Resampling-Based Multiple Testing, section 2.3 (smallest p); Gelman, Meng &
Stern 1996, Stat Sinica 6:733 (posterior predictive checks).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, orth
from scipy.special import chdtrc, chdtri

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Data, Fitted, Mask
from limbcli.diagnosis.explanations.noise import EXCESS, LinearFit, unit_errors
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

WHOLE = "whole"
_FEW_DATA = 40  # largest number of data in a part whose data are each shifted separately
_RCOND = 1e-7
_BATCH = 1000  # draws at a time
# Degrees of freedom of the variance in a part of an image: the error of the models in maps differs by a
# factor of 2 to 3 about its middle from site to site (`tests/benchmarks/map_errors.py`), and as much between
# parts of one.
_KNOWN_IN_IMAGE = 4.0
# Degree of the smooth curves; least degrees of freedom of their scatter; ratio of a prediction's standard
# deviation to that of its reading, above which a held-out block is skipped.
_DEGREE, _LEAST_NU, _TOO_WIDE = 4, 5, 1.0
_FEWEST = 2  # readings before and after a jump


@dataclass(frozen=True)
class Part:
    """One test: statistic, degrees of freedom, its own p, and p adjusted over the family."""

    name: str
    chi2: float
    nu: int
    p: float
    p_adjusted: float


@dataclass(frozen=True)
class Check:
    """The tests of one explanation's residual, the whole first."""

    parts: tuple[Part, ...]

    @property
    def p(self) -> float:
        """The smallest adjusted p."""
        return min((each.p_adjusted for each in self.parts), default=1.0)

    @property
    def flagged(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.parts[1:] if each.p_adjusted < decisions.FALSE_ALARMS)


def checked(data: Data, state: LinearFit, whiten: Whitener, rng: np.random.Generator) -> Check:
    """Check of a fit; state : its residual and sensitivities, whitened by `whiten`."""
    bases = {
        name: _base(data, mask, state, whiten)
        for name, mask in data.groups.items()
        if 0 < mask.sum() < len(mask)
    }
    names, left = [WHOLE, *bases], state.left
    imaged = [bool(np.all(data.imaged[data.groups[name]])) for name in bases]
    values = np.array([left @ left, *(np.sum((left @ base) ** 2) for base in bases.values())])
    nu = [state.nu, *(base.shape[1] for base in bases.values())]
    drawn = np.concatenate(
        [_statistics(state, bases, imaged, rng) for _ in range(decisions.N_DRAWS_OF_PARTS // _BATCH)]
    )
    n = len(drawn)
    alone = (1 + np.sum(drawn >= values, axis=0)) / (n + 1)
    order = np.argsort(np.argsort(-drawn, axis=0), axis=0)
    smallest = np.sort(((order + 1) / (n + 1)).min(axis=1))
    adjusted = (1 + np.searchsorted(smallest, alone, side="right")) / (n + 1)
    table = zip(names, values.tolist(), nu, alone.tolist(), np.minimum(adjusted, 1.0).tolist(), strict=True)
    return Check(tuple(Part(*row) for row in table))


def _statistics(
    state: LinearFit, bases: Mapping[str, Array], imaged: Sequence[bool], rng: np.random.Generator
) -> Array:
    errors = unit_errors(rng, (_BATCH, len(state.residual))).astype(np.float32)
    fitted = errors @ state.basis.astype(np.float32)
    whole = np.einsum("bi,bi->b", errors, errors) - np.einsum("bi,bi->b", fitted, fitted)
    parts = [np.sum((errors @ base.astype(np.float32)) ** 2, axis=1) for base in bases.values()]
    for part, in_image in zip(parts, imaged, strict=True):
        if in_image:
            part *= _KNOWN_IN_IMAGE / rng.chisquare(_KNOWN_IN_IMAGE, _BATCH)
    return np.array([whole, *parts], dtype=float).T


def _base(data: Data, mask: Mask, state: LinearFit, whiten: Whitener) -> Array:
    """Orthonormal basis (n, rank) of the shifts of a part's data that no fitted parameter reproduces."""
    shifts = np.eye(len(mask))[:, mask] if mask.sum() <= _FEW_DATA else _even(data, mask)
    seen = state.project(whiten(shifts))
    return np.asarray(orth(seen, rcond=_RCOND)) if np.any(seen) else np.zeros((len(mask), 0))


def _even(data: Data, mask: Mask) -> Array:
    """Smooth shifts (n, 9) of a part: up to quadratic in the level number and linear in the position."""
    t = _scaled(data.order, mask)
    place = np.zeros((len(mask), 2)) if data.place is None else np.nan_to_num(data.place)
    x, z = (_scaled(each, mask) for each in place.T)
    found = [np.where(mask, a * b, 0.0) for a in (np.ones_like(t), t, t**2) for b in (np.ones_like(t), x, z)]
    return np.stack(found, axis=1)


def _scaled(values: Array, mask: Mask) -> Array:
    """Values scaled to -1 to 1 within the part."""
    low, high = values[mask].min(), values[mask].max()
    return np.asarray(2 * (values - low) / max(high - low, 1e-9) - 1)


@dataclass(frozen=True)
class Roughness:
    """Scatter about a quartic along each series: ratio = chi2/nu (1: as stated); p of this much or more, of
    heavy-tailed errors, by a scaled chi2 (Satterthwaite) of mean nu and variance 2 nu + excess sum P_ii^2."""

    ratio: float
    p: float


def roughness(
    state: LinearFit, whiten: Whitener, *, series: Mapping[str, Mask], order: Array
) -> Roughness | None:
    """The residual's rough part over the stated noise; None below `_LEAST_NU` degrees of freedom."""
    n = len(order)
    columns = [state.jacobian]
    for mask in series.values():
        t = _scaled(order, mask)[mask]
        degree = min(_DEGREE, len(np.unique(t)) - 1)
        smooth = np.zeros((n, degree + 1))
        smooth[mask] = np.polynomial.legendre.legvander(t, degree)
        columns.append(whiten(smooth))
    wide = LinearFit.of(state.residual, np.hstack(columns))
    if wide.nu < _LEAST_NU:
        return None
    own = 1.0 - np.sum(wide.basis**2, axis=1)
    scale = 1.0 + EXCESS * float(own @ own) / (2.0 * wide.nu)
    return Roughness(wide.chi2 / wide.nu, float(chdtrc(wide.nu / scale, wide.chi2 / scale)))


def held_out_error(data: Data, fitted: Fitted) -> dict[str, float]:
    """Root-mean-square prediction error of held-out data, block by block and over all, in units of the
    noise's conditional standard deviation given the other data.

    Each block is left out in turn, all parameters are refitted to first order about the full fit, and the
    block is predicted with the expected value of errors that it shares with other data: a model cannot
    predict the gain of a level or a scanner. A block that holds the data that determine a parameter, so that
    its prediction is less precise than its readings (`_TOO_WIDE`), is skipped.
    """
    J = fitted.jacobian[:, np.any(fitted.jacobian != 0.0, axis=0)]  # without parameters fixed on a bound
    J = J / np.linalg.norm(J, axis=0)
    residual, covariance = data.y - fitted.prediction, data.noise.covariance
    found: dict[str, float] = {}
    squares, n_data = 0.0, 0
    for name, mask in determined_by_the_rest(data.blocks, J).items():
        keep = ~mask
        rest = cho_factor(covariance[np.ix_(keep, keep)], lower=True)
        known = cho_solve(rest, np.column_stack([covariance[np.ix_(keep, mask)], J[keep], residual[keep]]))
        of_errors, of_columns, of_residual = np.split(known, [mask.sum(), mask.sum() + J.shape[1]], axis=1)
        normal = J[keep].T @ of_columns
        spread = np.einsum("ij,jk,ik->i", J[mask], np.linalg.pinv(normal, rcond=1e-14), J[mask])
        if np.sqrt(np.mean(spread / data.deviation[mask] ** 2)) > _TOO_WIDE:
            continue
        step = np.linalg.lstsq(normal, J[keep].T @ of_residual[:, 0], rcond=1e-14)[0]
        error = residual - J @ step
        off = error[mask] - of_errors.T @ error[keep]
        left = covariance[np.ix_(mask, mask)] - covariance[np.ix_(mask, keep)] @ of_errors
        square = float(np.sum(Whitener.of(left)(off) ** 2))
        found[name] = float(np.sqrt(square / mask.sum()))
        squares, n_data = squares + square, n_data + int(mask.sum())
    if found:
        found["all"] = float(np.sqrt(squares / n_data))
    return found


def over_shared(errors: Sequence[Mapping[str, float]], blocks: Mapping[str, Mask]) -> list[dict[str, float]]:
    """The same errors, with "all" restricted to the blocks that every model predicts, for comparability.

    >>> blocks = {"a": np.ones(3, bool), "b": np.ones(1, bool)}
    >>> over_shared([{"a": 2.0, "b": 4.0, "all": 2.6}, {"a": 1.0, "all": 1.0}], blocks)[0]["all"]
    2.0
    """
    shared = [name for name in blocks if all(name in each for each in errors)]
    if not shared:
        return [dict(each) for each in errors]
    counts = [float(np.sum(blocks[name])) for name in shared]
    return [
        {**each, "all": float(np.sqrt(np.average([each[name] ** 2 for name in shared], weights=counts)))}
        for each in errors
    ]


def determined_by_the_rest(blocks: Mapping[str, Mask], J: Array) -> dict[str, Mask]:
    """Blocks that can be left out with every parameter still determined; J (n, p) : sensitivities."""
    scale = np.where(np.linalg.norm(J, axis=0) > 0, np.linalg.norm(J, axis=0), 1.0)
    usable = {}
    for name, mask in blocks.items():
        if not 0 < mask.sum() < len(mask):
            continue
        s = np.linalg.svd(J[~mask] / scale, compute_uv=False)
        if len(s) == J.shape[1] and (not len(s) or s[-1] > 1e-6 * s[0]):
            usable[name] = mask
    return usable


@dataclass(frozen=True)
class ForceJump:
    """size : N, added to all forces from level `level` on; chi2 : reduction of the misfit without effects"""

    size: float
    level: int
    chi2: float

    @property
    def sentence(self) -> str:
        """
        >>> ForceJump(-0.82, 7, 24.0).sentence[:76]
        'Or the zero of the load cell jumped by about -0.8 N between levels 6 and 7, '
        """
        return (
            f"Or the zero of the load cell jumped by about {self.size:.1g} N between levels "
            f"{self.level - 1} and {self.level}, which explains the readings as well. If the cell was tared "
            "anew there, correct the later forces, or measure again."
        )


def force_jump(data: Data, base: Fitted, *, explained: float) -> ForceJump | None:
    """The jump that explains the misfit of the fit without effects (`base`) best, to first order; None if it
    explains little, or less than the chi2 `explained` by the chosen effects. Not of several measurements
    together.

    Its place is chosen among those between all levels: its p is multiplied by their number, and 2 ln(their
    number) is taken off its chi2.
    """
    whiten = data.noise.whitener
    fit = base.whitened(data.y, whiten)
    found: list[ForceJump] = []
    mask = data.channels().get("force", np.zeros(len(data), dtype=bool))
    for level in np.unique(data.order[mask])[_FEWEST : 1 - _FEWEST]:
        step = fit.project(whiten((mask & (data.order >= level)).astype(float)))
        length = float(step @ step)
        if length > 0.0:
            pull = float(step @ fit.left)
            found.append(ForceJump(pull / length, int(level), pull**2 / length))
    best = max(found, key=lambda each: each.chi2, default=None)
    if best is None or best.chi2 < chdtri(1, decisions.CHECKED / len(found)):
        return None
    return best if best.chi2 - 2.0 * np.log(len(found)) >= explained else None
