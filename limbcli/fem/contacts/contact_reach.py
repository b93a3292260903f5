"""Estimates which nodes of a soft surface a rigid surface may touch."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, IntArray

_MARGIN = 0.0  # margin, in mean facet edge lengths: a larger root front costs more than it gains


def near_nodes(X: Array, rigid: IntArray, soft: IntArray, normals: Array) -> IntArray:
    """Nodes of the facets `soft` whose centroid lies under the facets `rigid`, seen along the mean normal.

    "Under" means inside their bounding rectangle along their principal axes, plus a margin. This only sizes
    the root front; contact itself is searched on all facets.

    X (n_points, 3) : reference positions
    rigid (n, 4) : nodes; the last is -1 in a triangle
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
