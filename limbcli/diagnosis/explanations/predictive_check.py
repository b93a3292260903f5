"""Posterior predictive check: is the residual of an explanation one that its noise gives, as a whole and in
parts?

The tests of the whole residual (chi2) and of every part of the data (a channel, a third of the levels, a
region of the maps) form one family; their p are adjusted by the smallest p in draws from the noise. The size
of the model's error in a region of an image is known only roughly: the draws of such a part have a variance
of their own.

Source: Westfall & Young 1993, Resampling-Based Multiple Testing, section 2.3 (smallest p); Gelman, Meng &
Stern 1996, Stat Sinica 6:733 (posterior predictive checks).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import orth

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Data, Mask
from limbcli.diagnosis.explanations.noise import LinearFit, unit_errors
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
        """Parts of the data that the fit does not describe."""
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
    return Check(
        tuple(
            Part(name, float(values[k]), nu[k], float(alone[k]), float(min(adjusted[k], 1.0)))
            for k, name in enumerate(names)
        )
    )


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
    """Orthonormal basis (n, rank) of the shifts of a part's data that the fitted parameters cannot
    reproduce."""
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
