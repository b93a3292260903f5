"""Remesh a boundary with facets of the requested sizes, and label its faces.

pymeshlab's isotropic remeshing was tried first: it uses one edge length at a time and detects features only
by their angle, so that it rounded the edges where a cut meets a bone at less than its threshold. The
operations in `facets` take a size field and preserve every edge between two labels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from limbcli.errors import MeshError
from limbcli.meshing.distance import Field
from limbcli.meshing.domain import BONE, CUT, TissueDomain
from limbcli.meshing.facets import (
    collapse_short,
    edges_of,
    flip,
    keep_unfolded,
    neighbour_sums,
    relax,
    split_long,
)
from limbcli.meshing.improve import FIXED, NodeConstraints, put_back
from limbcli.meshing.meshlab import open_pymeshlab
from limbcli.meshing.probe import PlacedProbe, distance_to_faces
from limbcli.meshing.surfaces import Triangles, undirected
from limbcli.model import Array, IntArray

# mm: neither curvature nor thin tissue reduces the edge length below this; a smaller requested size still can
_MIN_SIZE = 1.5
_AT_SURFACE = 1.5  # grid spacings: samples closer to a surface limit edges by its curvature
_CLEFT_SHARE = 4.0  # edges in narrow tissue or thin bone, as a multiple of half its width
_REFINED, _REFINED_MM = 0.6, 6.0  # size around a place that is meshed anew: share of the former, and how far
_GROWTH = 0.3  # largest growth of the edge length, mm per mm
_UNFOLDING_ROUNDS, _REMESHING_ROUNDS = 8, 10
_CROWDED = 0.1  # fraction of the target length: a shorter edge is an artefact
# cosine between the normals of two adjacent faces, below which they are folded onto each other
_FOLDED = -0.9998
# barycentric coordinates of points on a facet, a quarter of its edges apart
_ON_FACET = 0.25 * np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)])


@dataclass(frozen=True)
class Sizes:
    """Target edge lengths (mm): under the probe, far from it, and their growth (mm per mm).

    Strain is largest some millimetres below the face; edges that are longer there leave half as much error
    again in wave speeds, at about as many nodes (tests/benchmarks/figures/meshing.md).
    """

    under_probe: float = 2.5
    far: float = 12.0
    growth: float = 0.2
    reach: float = 4.0  # mm round the face in which the fine size is kept
    bends: float = 2.5  # lower limit of the edge length from curvature
    # lower limit of the edge length from thin tissue, thin bone and clefts, where facets do not meet
    thin: float = 0.0

    def __post_init__(self) -> None:
        """Convert integers to float, so that arrays made of them can hold fractions."""
        for each in fields(self):
            object.__setattr__(self, each.name, float(getattr(self, each.name)))

    def finer(self, factor: float) -> Sizes:
        return Sizes(
            self.under_probe * factor, self.far * factor, self.growth, self.reach,
            self.bends * factor, self.thin * factor,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SizeField:
    """Target edge length at any point: fine under the probes, coarse far away, finer where thin or curved.

    probes : one in a site's model; in a whole limb those at its sites, or none
    """

    sizes: Sizes
    probes: tuple[PlacedProbe, ...]
    domain: TissueDomain
    bend: Field  # upper limit of the edge length from curvature and thin places
    least: float

    def at(self, points: Array) -> Array:
        """Target edge length (n,), mm, at points (n, 3)."""
        s = self.sizes
        distance = distance_to_faces(self.probes, points)
        wanted = np.clip(s.under_probe + s.growth * np.maximum(distance - s.reach, 0), s.under_probe, s.far)
        return np.maximum(np.minimum(wanted, self.bend.at(points)), self.least)

    def graded_by_probe(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 3) are so near a face that edges are shorter there than far away."""
        s = self.sizes
        return distance_to_faces(self.probes, points) < s.reach + (s.far - s.under_probe) / s.growth


def size_field(domain: TissueDomain, probes: tuple[PlacedProbe, ...], sizes: Sizes) -> SizeField:
    """The size field of a domain: thickness and radius of curvature limit the size of the facets."""
    limit = np.full(domain.skin.grid.shape, sizes.far)
    if domain.bone is not None:
        thickness = np.abs(domain.bone.values) + np.abs(domain.skin.values)
        limit = np.minimum(limit, 1.4 * thickness + 0.3)
        limit = np.minimum(limit, _cleft_limit(domain, sizes.far))
        limit = np.maximum(limit, min(sizes.thin, sizes.far))
    for field in (domain.skin, domain.bone):
        if field is not None:
            at = np.abs(field.values) < _AT_SURFACE * field.grid.spacing
            # deviation from the true surface: small under the probes, of a whole limb at most twice that
            sag = 0.25 + 0.03 * distance_to_faces(probes, field.grid.points()[at])
            sag = np.minimum(sag, 2 * 0.25) if domain.whole else sag
            limit[at] = np.minimum(limit[at], _bend_limit(field, at, sag, sizes.far, least=sizes.bends))
    # samples at least 1 mm on the kept side of every cut; those beyond do not limit the size
    points = domain.skin.grid.points()
    keep = np.ones(points.shape[:3], bool)
    for plane in domain.planes:
        keep &= points @ plane.normal - plane.offset < -1.0
    limit[~keep] = sizes.far
    bend = Field(domain.skin.grid, _graded(limit, domain.skin.grid.spacing))
    return SizeField(sizes, probes, domain, bend, least=min(_MIN_SIZE, sizes.under_probe))


def _bend_limit(field: Field, at: NDArray[np.bool_], sag: Array, far: float, *, least: float) -> Array:
    """Edge length (n,) that keeps chords within `sag` (n,) of a curved surface: sqrt(8 sag / curvature).

    at : the n samples of the grid that are close to the surface
    """
    h = field.grid.spacing
    phi = ndimage.gaussian_filter(field.values, 1.5)
    gradient = np.gradient(phi, h)
    size = np.sqrt(sum(each**2 for each in gradient)) + 1e-6
    bend = np.abs(sum(np.gradient(g / size, h, axis=k) for k, g in enumerate(gradient)))
    return np.clip(np.sqrt(8 * sag / np.maximum(bend[at], 1e-6)), min(least, far), far)


def _cleft_limit(domain: TissueDomain, far: float) -> Array:
    """Edge length limit in narrow tissue or thin bone, at mid-width."""
    assert domain.bone is not None
    h = domain.skin.grid.spacing
    tissue = np.minimum(-domain.skin.values, domain.bone.values)
    out = np.full(tissue.shape, far, dtype=np.float64)
    for depth in (tissue, -domain.bone.values):
        slope = np.sqrt(sum(each**2 for each in np.gradient(depth, h)))
        middle = (depth > 0.3 * h) & (depth < far / _CLEFT_SHARE) & (slope < 0.75)
        out[middle] = np.minimum(out[middle], _CLEFT_SHARE * depth[middle])
    return np.maximum(out, _MIN_SIZE)


def finer_near(field: SizeField, places: Array) -> SizeField:
    """The size field reduced around places (n, 3) where facets intersect each other or have lost bone."""
    grid, sizes = field.bend.grid, field.bend.values
    values = np.where(grid.near(places, _REFINED_MM), _REFINED * np.minimum(sizes, field.sizes.far), sizes)
    bend = Field(grid, _graded(np.maximum(values, 0.5), grid.spacing))
    return replace(field, bend=bend, least=min(0.7, field.least))


def bad_places(boundary: Boundary) -> Array:
    """Centroids (n, 3) of faces that intersect others, or are folded onto a neighbour."""
    pymeshlab = open_pymeshlab()

    surface = boundary.surface
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(surface.points, surface.faces.astype(np.int32)))
    meshes.compute_selection_by_self_intersections_per_face()
    crossing = np.asarray(meshes.current_mesh().face_selection_array(), bool)
    return surface.centroids[crossing | _folded(surface)]


def lost_bone(boundary: Boundary, fine: Triangles, field: SizeField) -> Array:
    """Places (n, 3) of bone near a probe that lie farther from all facets than these are long.

    A bone as thin as its facets collapses, and tissue takes its place. `fine` : the boundary as triangulated
    before
    """
    graded = boundary.surface.points[boundary.surface.faces[boundary.labels == BONE]]
    places = fine.centroids[face_labels(fine, field.domain) == BONE]
    places = places[field.graded_by_probe(places)]
    if not len(graded) or not len(places):
        return places
    on_facets = np.einsum("sk,fkx->sfx", _ON_FACET, graded).reshape(-1, 3)
    return places[cKDTree(on_facets).query(places)[0] > field.at(places)]


def _folded(surface: Triangles) -> NDArray[np.bool_]:
    """Faces (n,) folded flat onto a neighbour; this is no intersection, but makes TetGen fail."""
    unit = surface.area_vectors / np.maximum(surface.areas, 1e-12)[:, None]
    _, sides = edges_of(surface.faces)
    flat = np.einsum("ij,ij->i", unit[sides[:, 0]], unit[sides[:, 1]]) < _FOLDED
    out = np.zeros(len(surface.faces), bool)
    out[sides[flat].ravel()] = True
    return out


def unfold(boundary: Boundary, domain: TissueDomain) -> Boundary:
    """Unfold faces that lie over their own surface by moving their nodes to the mean of their neighbours."""
    surface, labels = boundary.surface, boundary.labels
    constraints = NodeConstraints.of_faces(len(surface.points), surface.faces, labels)
    edges = np.unique(np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    for _ in range(_UNFOLDING_ROUNDS):
        boundary = Boundary(surface, labels)
        unit = surface.area_vectors / np.maximum(surface.areas, 1e-12)[:, None]
        folded = np.einsum("ij,ij->i", unit, outward_normals(boundary, domain)) < 0.1
        free = np.zeros(len(surface.points), bool)
        free[surface.faces[folded]] = True
        free &= (constraints.codes[:, 0] > 0) & (constraints.codes[:, 1] == 0)
        if not free.any():
            break
        total, count = neighbour_sums(surface.points, edges)
        points = surface.points.copy()
        points[free] = total[free] / count[free][:, None]
        surface = Triangles(put_back(points, constraints, domain), surface.faces)
    return Boundary(surface, labels)


def outward_normals(boundary: Boundary, domain: TissueDomain) -> Array:
    """The expected normal (n_faces, 3) of each face, from the surface it belongs to."""
    centroids, labels = boundary.surface.centroids, boundary.labels
    out = domain.skin.gradient(centroids)
    if domain.bone is not None:
        out[labels == BONE] = -domain.bone.gradient(centroids[labels == BONE])
    for k, plane in enumerate(domain.planes):
        out[labels == CUT + k] = plane.normal
    return out / np.maximum(np.linalg.norm(out, axis=1), 1e-12)[:, None]


def _graded(limit: Array, spacing: float) -> Array:
    """The limit, made to grow by at most `_GROWTH` with distance from where it applies."""
    out = limit
    for reach in (1, 2, 4, 8):
        shape = 2 * reach + 1
        out = np.minimum(out, ndimage.minimum_filter(out, size=shape) + _GROWTH * reach * spacing)
    return out


@dataclass(frozen=True, eq=False)
class Boundary:
    """A closed, graded boundary with a label for every face; its nodes lie on their surfaces."""

    surface: Triangles
    labels: IntArray


def remesh(fine: Triangles, domain: TissueDomain, field: SizeField) -> Boundary:
    """Graded facets for a finely triangulated boundary; its features (edges of the cuts) stay sharp.

    Raises MeshError if the surface is not closed.
    """
    _check_closed(fine)
    points, faces, labels = fine.points, fine.faces, face_labels(fine, domain)
    for _ in range(40):
        ranks, _ = _ranks(points, faces, labels)
        points, faces, labels, n = collapse_short(points, faces, labels, ranks, field.at(points))
        if n < 0.02 * len(faces):
            break
        faces, _ = flip(points, faces, labels)
    for _ in range(_REMESHING_ROUNDS):
        points, faces, labels = split_long(points, faces, labels, field.at(points))
        for _ in range(3):
            ranks, _ = _ranks(points, faces, labels)
            points, faces, labels, n = collapse_short(points, faces, labels, ranks, field.at(points))
        for _ in range(3):
            faces, n = flip(points, faces, labels)
        for _ in range(2):
            ranks, constraints = _ranks(points, faces, labels)
            points = keep_unfolded(points, put_back(points, constraints, domain), faces)
            moved = put_back(relax(points, faces, labels, ranks, field.at(points)), constraints, domain)
            points = keep_unfolded(points, moved, faces)
    for _ in range(4):  # collapse the edges that became too short when nodes moved along the features
        # faces of skin or bone whose three nodes lie in a cut belong to it: as skin they would constrain
        # three nodes to the cut's edge where two suffice
        out = labels.copy()
        for k, plane in enumerate(domain.planes):
            inside = (np.abs(plane.height(points)) < 1e-3)[faces].all(axis=1)
            out[inside & (labels < CUT)] = CUT + k
        labels = out
        if not _crowded(points, faces, field):
            break
        ranks, _ = _ranks(points, faces, labels)
        points, faces, labels, _ = collapse_short(points, faces, labels, ranks, field.at(points))
        faces, _ = flip(points, faces, labels)
    surface = Triangles(points, faces)
    _check_closed(surface)
    return Boundary(surface, labels)


def _crowded(points: Array, faces: IntArray, field: SizeField) -> bool:
    """Whether some edge is far shorter than the target length."""
    edges, _ = edges_of(faces)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    return bool((length < _CROWDED * field.at(points)[edges].mean(axis=1)).any())


def _ranks(points: Array, faces: IntArray, labels: IntArray) -> tuple[IntArray, NodeConstraints]:
    """Number of labels meeting at each node, and its constraints.

    At most 3 are counted; nodes where features branch count as 3.
    """
    constraints = NodeConstraints.of_faces(len(points), faces, labels)
    ranks = np.where(constraints.codes[:, 0] == FIXED, 3, np.where(constraints.codes[:, 1] > 0, 2, 1))
    edges, sides = edges_of(faces)
    feature = edges[labels[sides[:, 0]] != labels[sides[:, 1]]]
    at = np.bincount(feature.ravel(), minlength=len(points))
    return np.where((ranks == 2) & (at != 2), 3, ranks), constraints


def face_labels(surface: Triangles, domain: TissueDomain, *, tolerance: float = 0.02) -> IntArray:
    """Label of every face: a cut if it lies in that plane, else the nearer of skin and bone.

    tolerance : mm by which a face of a cut may deviate from its plane
    """
    labels = domain.label(surface.centroids)
    unit = surface.area_vectors / np.maximum(surface.areas, 1e-12)[:, None]
    uncut = TissueDomain(domain.skin, domain.bone, (), ())
    labels = np.where(labels >= CUT, uncut.label(surface.centroids), labels)
    for k, plane in enumerate(domain.planes):
        flat = np.abs(plane.height(surface.points))[surface.faces].max(axis=1) < tolerance
        labels[flat & (unit @ plane.normal > 0.9)] = CUT + k
    return labels


def _check_closed(surface: Triangles) -> None:
    edges = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, counts = np.unique(undirected(edges), return_counts=True)
    if (counts != 2).any():
        raise MeshError(
            f"the remeshed surface is open or branched at {int((counts != 2).sum())} edges",
            where="surface remeshing",
            fix="use a finer mesh (--size-mm), or smooth the segmentation",
        )
