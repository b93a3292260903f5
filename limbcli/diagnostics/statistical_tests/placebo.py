"""Placebo tests: would arbitrary smooth directions explain the residual as well?

Adding parameters always reduces the residual. The share of chi2 that an effect explains is
therefore compared with the share explained by the same number of arbitrary smooth directions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Mask
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.model import Array

_WAVES = 3


def smooth_directions(
    channels: Mapping[str, Mask], order: Array, deviation: Array, n: int, rng: np.random.Generator
) -> Array:
    """Random curves (n, n_data) along each channel, with up to three half waves, scaled by the noise."""
    drawn = np.zeros((n, len(order)))
    for mask in channels.values():
        x = order[mask]
        t = (x - x.min()) / max(float(np.ptp(x)), 1e-12)
        waves = np.cos(np.pi * np.outer(np.arange(_WAVES + 1), t))
        drawn[:, mask] = rng.standard_normal((n, _WAVES + 1)) @ waves
    return drawn * deviation


def placebo_percentile(
    state: LinearFit, whiten: Whitener, explained: float, *, n_parameters: int,
    channels: Mapping[str, Mask], order: Array, deviation: Array, rng: np.random.Generator,
) -> float:  # fmt: skip
    """Percent of placebos (`n_parameters` smooth directions each) that explain less of chi2."""
    curves = smooth_directions(channels, order, deviation, thresholds.N_PLACEBOS * n_parameters, rng)
    whitened = state.project(whiten(curves.T)).T.reshape(thresholds.N_PLACEBOS, n_parameters, -1)
    left = state.left
    share = np.empty(thresholds.N_PLACEBOS)
    for k, each in enumerate(whitened):
        q, _ = np.linalg.qr(each.T)
        share[k] = np.sum((q.T @ left) ** 2)
    return float(100.0 * np.mean(share < explained))


def library_percentile(
    state: LinearFit, whiten: Whitener, explained: float, *, n_parameters: int, n_tried: int,
    channels: Mapping[str, Mask], order: Array, deviation: Array, rng: np.random.Generator,
) -> float:  # fmt: skip
    """The same, allowing for selection: each placebo is the best of `n_tried` sets.

    An explanation is selected from many candidates or combinations of them, and so is its placebo.
    """
    n_libraries, least = 200, 2
    curves = smooth_directions(
        channels, order, deviation, n_libraries * max(n_tried, least) * n_parameters, rng
    )
    whitened = state.project(whiten(curves.T)).T.reshape(-1, n_parameters, len(order))
    q, _ = np.linalg.qr(np.swapaxes(whitened, 1, 2))
    share = np.sum(np.einsum("snk,n->sk", q, state.left) ** 2, axis=1)
    best = share.reshape(n_libraries, -1).max(axis=1)
    return float(100.0 * np.mean(best < explained))
