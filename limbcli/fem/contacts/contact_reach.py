"""Which nodes of a soft surface a rigid one may come to touch."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, IntArray

_MARGIN = 0.0  # edges of a facet: a wider root costs more than it gains


def near_nodes(X: Array, rigid: IntArray, soft: IntArray, normals: Array) -> IntArray:
    """Nodes of the facets `soft` whose middle lies under the facets `rigid`, seen along the mean normal.

    X (n_points, 3): places at rest; rigid (n, 4), -1 where a facet has three corners. "Under": within the
    rectangle around them along their principal axes, and a margin. Contact is searched everywhere.
    """
    if not len(rigid) or not len(soft):
        return np.zeros(0, dtype=np.int64)
    mean = normals.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-12)
    flat = np.eye(3) - np.outer(mean, mean)
    outline = X[np.unique(rigid[rigid >= 0])] @ flat
    middle = outline.mean(axis=0)
    axes = np.linalg.svd(outline - middle, full_matrices=False)[2][:2]
    along = (outline - middle) @ axes.T
    corners = X[soft[:, :3]]
    edge = float(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).mean())
    at = (corners.mean(axis=1) @ flat - middle) @ axes.T
    low, high = along.min(axis=0) - _MARGIN * edge, along.max(axis=0) + _MARGIN * edge
    inside = ((at >= low) & (at <= high)).all(axis=1)
    return np.unique(soft[inside])
