"""The mesh of a whole limb: graded tetrahedra between skin, bones and cut, the bones as rigid voids.

The tissue is bounded as in a site's model (`domain`), but by the limb's own ends only. Mid-side nodes of
tet10 on skin and bone lie on the curved surface wherever every cell there stays valid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.conforming_layers import Layer, core_of, open_ended, with_layers
from limbcli.meshing.crop import within
from limbcli.meshing.domain import BONE, CUT, SKIN, TissueDomain, make_domain
from limbcli.meshing.improve import NodeConstraints, put_back
from limbcli.meshing.limb_parts import LimbFrame
from limbcli.meshing.mending import Limb, Plane
from limbcli.meshing.probe import PlacedProbe
from limbcli.meshing.quality import EDGES, volumes
from limbcli.meshing.regions import facets, quadratic
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_mesher import VolumeMesh, mesh_volume
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, Block, IntArray, Mesh, Surface
from limbcli.progress import SILENT, Progress

PROXIMAL_CUT, DISTAL_CUT, HELD = "proximal_cut", "distal_cut", "held"
# Nodes of a mesh times its cubed edge length over the volume: of whole limbs, by element.
_NODES_PER_VOLUME = {"tet10": 16.0, "tet4": 2.3}
OFF, _ATTEMPTS = 0.2, 3  # accepted deviation of the number of nodes from the requested one; attempts
_SAMPLES = 4e6  # samples of the distance grid
_SPACING = (1.0, 2.5)  # mm between them
_FINEST = 0.45  # smallest edge length over thin tissue and on bends, as a fraction of the usual one
_ALONG = 0.5  # cosine between the axis and the normal of a cut end; below it, the cut runs along the limb
_SHORTEST = 30.0  # mm of limb that a cut must leave
# A curved cell is kept if its Jacobian is at least this fraction of that of the straight cell.
_LEAST_JACOBIAN = 0.15
_BULGE = 0.25  # largest offset of a mid-side node from its edge, as a fraction of the edge


@dataclass(frozen=True)
class LimbMeshOptions:
    """Options of a limb's mesh.

    nodes : requested number of nodes
    cut : height (mm) of the proximal cut above the limb's distal end; None: where the images end
    distal_cut : accept a limb that is cut at its distal end too
    probes : under them edges are as in the sites' own models, `under_probe` (mm) long and growing as there
    """

    element: str = "tet10"
    nodes: int = 40_000
    cut: float | None = None
    distal_cut: bool = False
    layers: tuple[Layer, ...] = ()
    probes: tuple[PlacedProbe, ...] = ()
    under_probe: float = Sizes.under_probe


@dataclass(frozen=True, eq=False)
class LimbMesh:
    """The mesh, its cut planes by name, and the findings of its construction.

    altered : where bone or tissue was changed so that it can be meshed, and bones that the mesh has lost
    expected : volume (mm3) of the tissue between the surfaces that were meshed
    size : usual edge length (mm)
    curved_share : fraction of the skin's and bones' mid-side nodes that lie on the curved surface
    """

    mesh: Mesh
    planes: Mapping[str, Plane]
    altered: tuple[str, ...]
    maker: str
    size: float
    expected: float
    curved_share: float


def end_planes(limb: Limb, frame: LimbFrame, options: LimbMeshOptions, *, where: str) -> dict[str, Plane]:
    """The planes in which the limb ends, by name: `proximal_cut`, and `distal_cut` if that is accepted.

    Raises CaseError if the limb has no proximal cut, is cut at its distal end too, or along its side.
    """
    found: dict[str, Plane] = {}
    for each in limb.ends:
        along = float(each.normal @ frame.axis)
        if abs(along) < _ALONG:
            raise CaseError(
                f"the skin is open along the limb: a cut there is {np.degrees(np.arccos(abs(along))):.0f} "
                "degrees from being across it",
                where=where,
                fix="give the skin closed all round; only its proximal end may be open",
            )
        found[PROXIMAL_CUT if along > 0 else DISTAL_CUT] = each
    if DISTAL_CUT in found and not options.distal_cut:
        raise CaseError(
            "the limb is cut at both ends: its distal end was not imaged",
            where=where,
            fix="give surfaces or images with the distal end; or mesh the piece as it is, with its distal "
            "cut as a free surface: --distal-cut",
        )
    if options.cut is not None:
        found[PROXIMAL_CUT] = _cut_at(options.cut, frame, found.get(PROXIMAL_CUT), where)
    if PROXIMAL_CUT not in found:
        raise CaseError(
            "the skin has no cut end: it is closed and rounded at its proximal end",
            where=where,
            fix=f"say where to cut it: --cut-mm, a height up to {frame.length:.0f} mm above its distal end",
        )
    return found


def _cut_at(height: float, frame: LimbFrame, before: Plane | None, where: str) -> Plane:
    top = frame.length if before is None else float(frame.height(before.normal[None] * before.offset)[0])
    if not _SHORTEST <= height <= top:
        raise CaseError(
            f"the cut {height:g} mm above the distal end is outside of the limb",
            where=f"{where}, --cut-mm",
            fix=f"give {_SHORTEST:g} to {top:.0f} mm",
        )
    return Plane(frame.axis, float(frame.axis @ frame.origin) + height)


def limb_mesh(
    limb: Limb,
    bones: Mapping[str, Triangles],
    frame: LimbFrame,
    options: LimbMeshOptions,
    *,
    where: str = "limb",
    progress: Progress = SILENT,
) -> LimbMesh:
    """Tetrahedra of the whole limb with its named surfaces.

    Blocks: `tissue`, and `fat`, `skin` if layers are requested. Surfaces: `skin`, each bone by its name,
    `proximal_cut`, `distal_cut`; every boundary facet is in exactly one. Node sets: the bones (disjoint),
    `proximal_cut`, and `held` (the nodes of the proximal cut that belong to no bone).

    limb : patient LPS, mm, as `mend` returns it; bones : the same bones by name, closed or not

    Raises CaseError if the limb's ends, its bones or the options cannot be used; MeshError if no volume mesh
    of sufficient quality could be made.
    """
    if not limb.bones:
        raise CaseError(
            "the limb has no bones",
            where=where,
            fix="give the bones' surfaces or labels: a socket is carried by them",
        )
    planes = end_planes(limb, frame, options, where=where)
    progress.event("task", name="limb: distances", done=0, total=3)
    extent = np.prod(np.ptp(limb.skin.points, axis=0))
    spacing = float(np.clip((extent / _SAMPLES) ** (1 / 3), *_SPACING))
    domain = make_domain(limb, tuple(planes.values()), spacing=spacing, whole=True)
    filled = open_ended(domain, options.layers) if options.layers else domain
    core = core_of(filled, options.layers) if options.layers else None
    volume, kinds, size = _sized(filled, core, options, progress)
    mesh, curved = _assembled(volume, kinds, bones, domain, planes, options)
    progress.event("task", name="limb: mesh", done=3, total=3)
    altered = (*domain.notes, *_lost_bones(mesh, bones, planes, size))
    return LimbMesh(mesh, planes, altered, volume.maker, size, domain.boundary.volume, curved)


def _sized(
    domain: TissueDomain, core: TissueDomain | None, options: LimbMeshOptions, progress: Progress
) -> tuple[VolumeMesh, IntArray, float]:
    """Cells, their blocks, and the edge length at which the mesh has about the requested number of nodes."""
    inside = (core or domain).boundary.volume
    size = float((_NODES_PER_VOLUME[options.element] * inside / options.nodes) ** (1 / 3))
    reach = Sizes.reach + sum(each.thickness for each in options.layers)
    best: tuple[float, VolumeMesh, IntArray, float] | None = None
    for _ in range(_ATTEMPTS):
        progress.event("task", name=f"limb: volume, edges of {size:.1f} mm", done=1, total=3)
        sizes = Sizes(options.under_probe, size, reach=reach, bends=_FINEST * size, thin=_FINEST * size)
        volume = mesh_volume(core or domain, options.probes, sizes)
        kinds = np.zeros(len(volume.cells), np.int64)
        if core is not None:
            volume, kinds = with_layers(volume, core, domain.skin, options.layers)
        ratio = _n_nodes(volume, options.element) / options.nodes
        if best is None or abs(np.log(ratio)) < best[0]:
            best = abs(float(np.log(ratio))), volume, kinds, size
        if abs(ratio - 1) <= OFF:
            break
        size *= ratio ** (1 / 3)
    assert best is not None
    return best[1], best[2], best[3]


def _n_nodes(volume: VolumeMesh, element: str) -> int:
    if element == "tet4":
        return len(volume.points)
    ends = np.sort(volume.cells[:, EDGES].reshape(-1, 2), axis=1)
    return len(volume.points) + len(np.unique(ends[:, 0] * len(volume.points) + ends[:, 1]))


def _assembled(
    volume: VolumeMesh, kinds: IntArray, bones: Mapping[str, Triangles], domain: TissueDomain,
    planes: Mapping[str, Plane], options: LimbMeshOptions,
) -> tuple[Mesh, float]:  # fmt: skip
    points, cells, middle, curved = volume.points, volume.cells, None, 0.0
    if options.element == "tet10":
        points, cells, middle = quadratic(points, cells)
    labelled = {"skin": volume.faces[volume.labels == SKIN]}
    labelled |= _of_bones(volume.points, volume.faces[volume.labels == BONE], bones)
    labelled |= {name: volume.faces[volume.labels == CUT + k] for k, name in enumerate(planes)}
    surfaces = {name: Surface(name, facets(each, middle)) for name, each in labelled.items() if len(each)}
    if middle is not None:
        points, curved = _curved(points, cells, volume, middle, domain)
    sets: dict[str, IntArray] = {}
    taken = np.zeros(len(points), bool)
    for name in bones:
        if name in surfaces:
            nodes = np.unique(next(iter(surfaces[name].facets.values())))
            sets[name] = nodes[~taken[nodes]]
            taken[nodes] = True
    for name in planes:
        if name in surfaces:
            sets[name] = np.unique(next(iter(surfaces[name].facets.values())))
    cut = sets.get(PROXIMAL_CUT, np.zeros(0, np.int64))
    sets[HELD] = cut[~taken[cut]]
    names = ("tissue", *(each.name for each in reversed(options.layers)))
    kind = "tet4" if middle is None else "tet10"
    blocks = [Block(name, kind, cells[kinds == k]) for k, name in enumerate(names)]  # type: ignore[arg-type]
    return Mesh(points, tuple(each for each in blocks if len(each.cells)), sets, surfaces), curved


def _of_bones(points: Array, faces: IntArray, bones: Mapping[str, Triangles]) -> dict[str, IntArray]:
    """The bone facets (m, 3) of each bone: those nearest to it."""
    names = list(bones)
    trees = [cKDTree(np.vstack([each.points, each.centroids])) for each in bones.values()]
    if not len(faces) or not names:
        return {}
    middles = points[faces].mean(axis=1)
    nearest = np.argmin(np.stack([tree.query(middles)[0] for tree in trees]), axis=0)
    return {name: faces[nearest == k] for k, name in enumerate(names)}


def _lost_bones(
    mesh: Mesh, bones: Mapping[str, Triangles], planes: Mapping[str, Plane], size: float
) -> list[str]:
    """A sentence for each bone between the cuts that has no facet in the mesh."""
    inside = tuple(planes.values())
    return [
        f"{name} is not in the mesh: the bone is thinner than the facets, whose edges are {size:.0f} mm, and "
        "tissue takes its place. Ask for more nodes (--nodes)"
        for name, each in bones.items()
        if name not in mesh.surfaces and within(each.points, inside).any()
    ]


# ---------------------------------------------------------------- curved cells


def _curved(
    points: Array,
    cells: IntArray,
    volume: VolumeMesh,
    middle: Mapping[tuple[int, int], int],
    domain: TissueDomain,
) -> tuple[Array, float]:
    """Mid-side nodes of skin and bone on their surface, except where a cell would not stay valid."""
    outer = facets(volume.faces, dict(middle))["tri6"]
    constraints = NodeConstraints.of_faces(len(points), outer[:, 3:], volume.labels)
    wanted = put_back(points, constraints, domain)
    ends = np.array(list(middle), np.int64)
    numbers = np.fromiter(middle.values(), np.int64)
    length = np.zeros(len(points))
    length[numbers] = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    moved = np.linalg.norm(wanted - points, axis=1)
    movable = (constraints.codes[:, 0] > 0) & (moved > 0)
    keep = movable & (moved <= _BULGE * length)
    while True:
        x = np.where(keep[:, None], wanted, points)
        bad = least_jacobians(x, cells) < _LEAST_JACOBIAN * 6 * volumes(points, cells)
        back = np.unique(cells[bad][:, 4:])
        back = back[keep[back]]
        if not len(back):
            return x, float(keep.sum() / max(movable.sum(), 1))
        keep[back] = False


def least_jacobians(points: Array, cells: IntArray) -> Array:
    """Lower bound (n_cells,) of det(dx/dxi) anywhere in a cell; 6 V where the cell is straight.

    Of tet10 it is the smallest Bernstein coefficient of the determinant, a cubic: where it is positive, the
    cell is valid at every point and not just at those of integration.

    >>> x, cells, _ = quadratic(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    >>> least_jacobians(x, cells).round(12)
    array([1.])

    Source: Johnen, Remacle and Geuzaine, J. Comput. Phys. 233 (2013), section 2 (the bound for any order).
    """
    if cells.shape[1] == 4:
        return 6 * volumes(points, cells)
    corners, mids = points[cells[:, :4]], points[cells[:, 4:]]
    control = np.empty((len(cells), 4, 4, 3))
    for k in range(4):
        control[:, k, k] = corners[:, k]
    for (i, j), middle in zip(EDGES, np.moveaxis(mids, 1, 0), strict=True):
        control[:, i, j] = control[:, j, i] = 2 * middle - 0.5 * (corners[:, i] + corners[:, j])
    slopes = 2 * (control[:, :, 1:] - control[:, :, :1])  # (n, corner, direction, 3)
    cross = np.cross(slopes[:, :, None, 0], slopes[:, None, :, 1])  # (n, l, m, 3)
    det = np.einsum("nlmi,nki->nlmk", cross, slopes[:, :, 2])
    mean = sum(np.transpose(det, (0, *(1 + k for k in order))) for order in permutations(range(3))) / 6
    return np.asarray(mean).reshape(len(cells), -1).min(axis=1)


def cell_centroids(mesh: Mesh, block: Block) -> Array:
    """Centroids (n_cells, 3) of a block's corners, mm."""
    return np.asarray(mesh.points[block.cells[:, :4]].mean(axis=1))


def check_invariants(found: LimbMesh) -> None:
    """Raise MeshError if cells are not valid, or if the surfaces do not share out the boundary.

    Raises MeshError with the number of faulty cells or facets.
    """
    mesh = found.mesh
    cells = np.concatenate([each.cells for each in mesh.solid_blocks])
    bad = int((least_jacobians(mesh.points, cells) <= 0).sum())
    corners = cells[:, :4][:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
    _, counts = np.unique(np.sort(corners, axis=1), axis=0, return_counts=True)
    outer = sum(each.n_facets for each in mesh.surfaces.values())
    if bad or outer != int((counts == 1).sum()) or counts.max() > 2:
        raise MeshError(
            f"{bad} cells are not valid; {outer} named facets of {int((counts == 1).sum())} on the boundary",
            where="limb",
            fix="use another number of nodes (--nodes)",
        )


def with_surfaces(mesh: Mesh, more: Mapping[str, Surface], sets: Mapping[str, IntArray]) -> Mesh:
    """The mesh with further surfaces and node sets."""
    return replace(mesh, surfaces={**mesh.surfaces, **more}, node_sets={**mesh.node_sets, **sets})
