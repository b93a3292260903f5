"""Named sets and surfaces of a site's mesh, and the step from tet4 to tet10."""

from __future__ import annotations

import numpy as np

from limbcli.meshing.domain import BONE, CUT, SKIN
from limbcli.meshing.probe import ProbeMesh, ProbeShape
from limbcli.meshing.quality import EDGES
from limbcli.meshing.site_mesher import VolumeMesh
from limbcli.model import Array, Block, IntArray, Mesh, Surface

PROBE_QUADS, PROBE_TIPS = "probe", "probe_tips"
# mm in plan and in depth: skin this close to the face can come into contact with the probe
_REACH_BESIDE, _REACH_DEPTH = 14.0, 25.0


def quadratic(points: Array, cells: IntArray) -> tuple[Array, IntArray, dict[tuple[int, int], int]]:
    """tet10 from tet4: mid-side nodes at the midpoints of straight edges, numbered after the corners.

    >>> _, cells, _ = quadratic(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    >>> cells.shape
    (1, 10)
    """
    ends = np.sort(cells[:, EDGES].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(ends, axis=0, return_inverse=True)
    middles = points[unique].mean(axis=1)
    numbers = inverse.reshape(-1, 6) + len(points)
    lookup = {(int(a), int(b)): len(points) + k for k, (a, b) in enumerate(unique)}
    return np.vstack([points, middles]), np.hstack([cells, numbers]), lookup


def facets(faces: IntArray, middle: dict[tuple[int, int], int] | None) -> dict[str, IntArray]:
    """Faces (m, 3) as tri3, or as tri6 with the mid-side nodes of their edges (12, 23, 31)."""
    if middle is None:
        return {"tri3": faces}
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    mids = np.array([[middle[int(a), int(b)] for a, b in face] for face in ends], np.int64).reshape(-1, 3)
    return {"tri6": np.hstack([faces, mids])}


def reachable(points: Array, faces: IntArray, probe: ProbeShape) -> Array:
    """Which faces (m,) can come into contact with the probe: near it in plan, not far below, facing up."""
    corners = points[faces]
    middle = corners.mean(axis=1)
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0
    near = probe.distance_in_plan(middle[:, 0], middle[:, 1]) < _REACH_BESIDE
    return up & near & (middle[:, 2] > -_REACH_DEPTH)


def assemble(
    volume: VolumeMesh, layers: IntArray, names: tuple[str, ...], probe: ProbeShape, rigid: ProbeMesh, *,
    element: str,
) -> Mesh:  # fmt: skip
    """Tissue and probe as one mesh with its named sets.

    layers (n_cells,) gives the index of each cell's block in `names` (such as tissue, fat, skin).
    """
    points, cells, middle = volume.points, volume.cells, None
    if element == "tet10":
        points, cells, middle = quadratic(points, cells)
    labels, faces = volume.labels, volume.faces
    chosen = {
        "skin": labels == SKIN,
        "bone": labels == BONE,
        "cut": labels >= CUT,
        "contact": (labels == SKIN) & reachable(volume.points, faces, probe),
    }
    surfaces = {
        name: Surface(name, facets(faces[keep], middle)) for name, keep in chosen.items() if keep.any()
    }
    sets: dict[str, IntArray] = {
        name: np.unique(np.concatenate([each.ravel() for each in surfaces[name].facets.values()]))
        for name in ("bone", "cut", "skin")
        if name in surfaces
    }
    held = [sets[name] for name in ("bone", "cut") if name in sets]
    sets["fixed"] = np.unique(np.concatenate(held)) if held else np.zeros(0, np.int64)
    first = len(points)
    face = Surface("probe_face", {"quad4": rigid.quads + first, "tri3": rigid.tips + first})
    blocks = [Block(name, "tet10" if middle else "tet4", cells[layers == k]) for k, name in enumerate(names)]
    blocks = [each for each in blocks if len(each.cells)]
    blocks += [
        Block(PROBE_QUADS, "quad4", rigid.quads + first),
        Block(PROBE_TIPS, "tri3", rigid.tips + first),
    ]
    return Mesh(np.vstack([points, rigid.points]), tuple(blocks), sets, {**surfaces, "probe_face": face})
