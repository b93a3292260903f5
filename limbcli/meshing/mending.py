"""Prepare surfaces of any origin for meshing, and record what was repaired.

Repaired here is what can be recognised from the triangles: bodies are sorted, stray pieces dropped, faces
oriented, holes closed and flat ends of a scan detected. Overlaps, self-intersections and clearances are
resolved on the distance grid (`domain`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.errors import MeshError
from limbcli.meshing.distance import Heights
from limbcli.meshing.meshlab import open_pymeshlab
from limbcli.meshing.surfaces import Triangles, bodies, boundary_loops, join, undirected
from limbcli.model import Array
from limbcli.model.patient_frame import HEAD

_ELONGATED = 1.5  # length-to-width ratio of a body below which it does not show the direction of the limb
ENDS = ("open", "flat")  # names of the planes where the limb itself was cut
_STRAY_EXTENT = 0.05  # fraction of the largest body's diagonal: smaller open pieces are stray
_CAP_SHARE = 0.6  # flat area that makes an end a cap, as a fraction of the cross-section 5 mm further in
_CAP_COSINE = 0.97
_CAP_SLAB = 1.5  # mm: deviation from its plane within which a cap is flat
_RIM_SHARE = 0.5  # fraction of the cross-section just inside: a smaller rim is a hole in the skin, not an end
_WITHIN = 0.3  # mm below a body's surface, beyond which another body lies inside it
_INSIDE = 1.5  # mm: distance of the new cut inside an open or capped end


@dataclass(frozen=True, eq=False)
class Plane:
    """A cutting plane: tissue is kept where normal . x <= offset (mm)."""

    normal: Array
    offset: float
    name: str = "cut"

    def height(self, points: Array) -> Array:
        """Signed distance beyond the plane (n,)."""
        return points @ self.normal - self.offset

    def moved(self, transform: Array) -> Plane:
        normal = transform[:3, :3] @ self.normal
        return Plane(normal, float(self.offset + normal @ transform[:3, 3]), self.name)


@dataclass(frozen=True, eq=False)
class Limb:
    """Closed skin and bones in one frame, the planes where the limb was cut, and notes on repairs."""

    skin: Triangles
    bones: tuple[Triangles, ...]
    ends: tuple[Plane, ...]
    notes: tuple[str, ...]

    def moved(self, transform: Array) -> Limb:
        return Limb(
            self.skin.moved(transform),
            tuple(each.moved(transform) for each in self.bones),
            tuple(each.moved(transform) for each in self.ends),
            self.notes,
        )


def mend(
    skin: Triangles, bones: list[Triangles], *, where: str = "surfaces", beside: Sequence[Triangles] = ()
) -> Limb:
    """Closed, outward-oriented bodies from the given surfaces.

    Further bodies in the skin's own file count as bones. Open ends are closed with a fan of triangles; where
    the limb was cut open, or has the flat end of a scan, a plane just inside the end replaces the closure.

    beside : bodies that are not part of the limb, but show its direction

    Raises MeshError if no body encloses a volume that could be a limb.
    """
    notes: list[str] = []
    pieces = _without_strays(bodies(skin), notes, "skin")
    within = pieces[1:]
    if within and bones:
        notes.append(f"skin: {len(within)} more bodies in its file taken as bones too")
    elif within:
        notes.append(
            f"skin: its file holds {len(within) + 1} bodies; the largest is the skin, the others bones"
        )
    loops: list[Array] = []
    outer = _closed(pieces[0], notes, "skin", loops)
    n_skin_loops = len(loops)
    inner = []
    for number, each in enumerate([*within, *bones], start=1):
        for body in _without_strays(bodies(each), notes, f"bone {number}"):
            inner.append(_closed(body, notes, f"bone {number}", loops))
    if outer.volume < 1e4:
        raise MeshError(
            f"the skin surface encloses {outer.volume / 1e3:.2f} cm3",
            where=where,
            fix="give the skin as a nearly closed surface in mm; check the unit of its coordinates, or give "
            "its `unit` in [imaging]",
            volume_mm3=outer.volume,
        )
    inner = _bones_in_reach(outer, inner, notes, where)
    ends = _open_ends(outer, loops, n_skin_loops) or _flat_ends(outer, long_axis([outer, *inner, *beside]))
    for end in ends:
        notes.append(f"skin: {end.name} end taken as a cut, {_INSIDE:g} mm inside it")
    return Limb(outer, tuple(inner), tuple(ends), tuple(notes))


def skin_and_bones(surface: Triangles) -> list[Triangles]:
    """The bodies in a file that contains a limb, the largest (its skin) first; stray pieces are dropped."""
    return _without_strays(bodies(surface), [], "skin")


def largest_and_fragments(skin: Triangles) -> tuple[Triangles, list[Triangles]]:
    """A skin's largest body with what lies inside it, and all other pieces, largest first.

    Pieces inside the body may be bones; those outside it are scraps of a scan, or another body.
    """
    largest, *others = bodies(skin)
    if not others:
        return skin, []
    above = Heights(_closed(largest, [], "skin", []))
    is_inside = [float(np.median(above.of(each.points))) < -_WITHIN for each in others]
    outside = [each for each, within in zip(others, is_inside, strict=True) if not within]
    inside = [each for each, within in zip(others, is_inside, strict=True) if within]
    return join([largest, *inside]) if outside else skin, outside


def without_cavities(pieces: Sequence[Triangles]) -> list[Triangles]:
    """The bodies, largest first, except those inside another.

    The wall of a bone's marrow cavity is not a bone.
    """
    kept: list[Triangles] = []
    for each in pieces:
        if not any(lies_within(each, other) for other in kept):
            kept.append(each)
    return kept


def lies_within(inner: Triangles, outer: Triangles) -> bool:
    """Whether a body lies inside another, and not on its surface like a duplicate of the same body."""
    low, high = outer.points.min(axis=0), outer.points.max(axis=0)
    if not ((inner.points >= low) & (inner.points <= high)).all():
        return False
    return float(np.median(Heights(_closed(outer, [], "body", [])).of(inner.points))) < -_WITHIN


def _without_strays(pieces: list[Triangles], notes: list[str], name: str) -> list[Triangles]:
    """The pieces that are bodies: large, or closed and not tiny."""
    extent = [np.linalg.norm(np.ptp(each.points, axis=0)) for each in pieces]
    large = [len(p.faces) >= 4 and x > _STRAY_EXTENT * extent[0] for p, x in zip(pieces, extent, strict=True)]
    kept = [each for each, is_large in zip(pieces, large, strict=True) if is_large]
    if not kept:
        raise MeshError("the surface has no body", where=name, fix="give a nearly closed triangle surface")
    dropped = sum(len(each.faces) for each in pieces) - sum(len(each.faces) for each in kept)
    if dropped:
        notes.append(f"{name}: {len(pieces) - len(kept)} stray pieces ({dropped} triangles) removed")
    return kept


def _closed(body: Triangles, notes: list[str], name: str, loops: list[Array]) -> Triangles:
    """Close holes with fans and orient faces outward; the rims of the holes are added to `loops`."""
    body = _coherent(body, notes, name)
    closed, rims = _lidded(body)
    loops += rims
    if rims:
        notes.append(f"{name}: {len(rims)} open rim{'s' if len(rims) > 1 else ''} closed")
    return closed if closed.volume > 0 else closed.flipped()


def _lidded(body: Triangles) -> tuple[Triangles, list[Array]]:
    """The body with its open rims closed by fans, and the points of the rims."""
    points, faces = [body.points], [body.faces]
    n = len(body.points)
    rims = boundary_loops(body)
    if not rims:
        return body, []
    for rim in rims:
        points.append(body.points[rim].mean(axis=0)[None])
        faces.append(np.stack([np.roll(rim, -1), rim, np.full(len(rim), n)], axis=1))
        n += 1
    closed = Triangles(np.concatenate(points), np.concatenate(faces).astype(np.int64))
    return closed, [body.points[rim] for rim in rims]


def open_rims(body: Triangles) -> list[tuple[Array, float]]:
    """Centre (3,) and longest side (mm) of every open rim, the widest first."""
    rims = [body.points[each] for each in boundary_loops(body)]
    found = [(each.mean(axis=0), float(np.ptp(each, axis=0).max())) for each in rims]
    return sorted(found, key=lambda each: -each[1])


def turned_inward(body: Triangles) -> bool:
    """Whether a body's normals point inward; open rims are closed for the test."""
    return _lidded(body)[0].volume < 0


def enclosed(body: Triangles) -> float:
    """Volume (mm3) of a body with its open rims closed, for any position and orientation of its faces.

    >>> from limbcli.meshing.surfaces import tetrahedron
    >>> open_box = tetrahedron().moved(np.eye(4) + 9.0 * np.eye(4, k=3)).part(np.arange(3))
    >>> round(enclosed(open_box), 6), round(enclosed(open_box.flipped()), 6)
    (0.166667, 0.166667)
    """
    return _closed(body, [], "body", []).volume


def _coherent(body: Triangles, notes: list[str], name: str) -> Triangles:
    """Flip faces that do not agree with their neighbours.

    The orientation is consistent if every edge is traversed equally often in both directions, or only once:
    two sheets may meet in an edge with four faces, and separating them would open the surface.
    """
    if body.is_closed:
        return body
    edges = body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, which = np.unique(undirected(edges), return_inverse=True)
    balance = np.bincount(which, weights=np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    if (np.abs(balance) <= 1).all():
        return body
    pymeshlab = open_pymeshlab()

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(body.points, body.faces.astype(np.int32)))
    meshes.meshing_repair_non_manifold_edges()
    meshes.meshing_re_orient_faces_coherently()
    mesh = meshes.current_mesh()
    notes.append(f"{name}: non-manifold edges split, faces oriented consistently")
    return Triangles(mesh.vertex_matrix().astype(float), mesh.face_matrix().astype(np.int64))


def _bones_in_reach(skin: Triangles, bones: list[Triangles], notes: list[str], where: str) -> list[Triangles]:
    """Bones whose bounding box meets that of the skin; there must be at least one if any is given."""
    low, high = skin.points.min(0), skin.points.max(0)
    kept = [b for b in bones if (b.points.max(0) > low).all() and (b.points.min(0) < high).all()]
    if len(kept) < len(bones):
        notes.append(f"{len(bones) - len(kept)} bones lie entirely outside the skin and are excluded")
    if bones and not kept:
        raise MeshError(
            f"all {len(bones)} bones lie outside the skin",
            where=where,
            fix="give skin and bones in one frame (mm, patient LPS)",
        )
    return kept


def _open_ends(skin: Triangles, loops: list[Array], n_skin_loops: int) -> list[Plane]:
    """A plane just inside every large open end of the skin (and of bones that end there)."""
    centre = skin.centroids.mean(axis=0)
    planes = []
    for rim in loops[:n_skin_loops]:
        middle = rim.mean(axis=0)
        normal = np.linalg.svd(rim - middle)[2][2]
        normal = normal if normal @ (middle - centre) > 0 else -normal
        radius = np.linalg.norm(rim - middle, axis=1).mean()
        if radius < 15.0 or not _is_end(skin, rim, normal):  # mm: a hole, not an end
            continue
        near = [each for each in loops if abs((each.mean(0) - middle) @ normal) < 15.0]
        offset = min(float((each @ normal).min()) for each in near) - _INSIDE
        planes.append(Plane(normal, offset, ENDS[0]))
    return planes


def _is_end(skin: Triangles, rim: Array, normal: Array) -> bool:
    """Whether an open rim encircles the limb: the cross-section just inside it is about as large as the rim.

    Next to a hole in the side of the limb, the section runs along the limb and is larger. The area vectors
    beyond a plane add up to the section in it (closed surface).
    """
    spokes = rim - rim.mean(axis=0)
    opening = abs(float(0.5 * np.cross(spokes, np.roll(spokes, -1, axis=0)).sum(axis=0) @ normal))
    beyond = skin.centroids @ normal > float((rim @ normal).min()) - _INSIDE
    section = abs(float((skin.area_vectors[beyond] @ normal).sum()))
    return opening > _RIM_SHARE * section


def _flat_ends(skin: Triangles, axis: Array) -> list[Plane]:
    """Planes just inside flat ends, as left by the first and last slice of a scan; axis: that of the limb."""
    planes: list[Plane] = []
    area, size, centroids = skin.area_vectors, skin.areas, skin.centroids
    unit = area / np.maximum(size, 1e-12)[:, None]
    for normal in _flat_directions(skin, axis):
        facing = unit @ normal > _CAP_COSINE
        if not facing.any():
            continue
        height = centroids @ normal
        top = _heaviest_slab(height[facing], size[facing])
        flat = facing & (np.abs(height - top) < _CAP_SLAB)
        # The area vectors beyond a plane add up to the section there (closed surface).
        section = abs(float((area[height > top - 5.0] @ normal).sum()))
        at_end = (
            top > np.quantile(skin.points @ normal, 0.95) - 2.0 and top > (skin.points @ normal).max() - 12.0
        )
        if at_end and size[flat].sum() > _CAP_SHARE * section:
            offset = float(np.quantile(height[flat], 0.02)) - _INSIDE
            planes.append(Plane(normal, offset, ENDS[1]))
    return planes


def _flat_directions(skin: Triangles, axis: Array) -> list[Array]:
    """Mean normals of the two ends along the limb's long axis."""
    unit = skin.area_vectors / np.maximum(skin.areas, 1e-12)[:, None]
    out = []
    for sign in (1.0, -1.0):
        near = unit @ (sign * axis) > 0.85
        if not near.any():
            continue
        # The most common normal there: a mean restricted iteratively to the normals close to it.
        weight = skin.areas[near]
        mean = (unit[near] * weight[:, None]).sum(0)
        for _ in range(5):
            mean /= np.linalg.norm(mean)
            close = unit[near] @ mean > _CAP_COSINE
            mean = (unit[near][close] * weight[close][:, None]).sum(0)
        out.append(mean / np.linalg.norm(mean))
    return out


def _heaviest_slab(height: Array, weight: Array) -> float:
    """The height around which most of the area lies."""
    edges = np.arange(height.min() - 1.0, height.max() + 2.0, 1.0)
    counts, _ = np.histogram(height, bins=edges, weights=weight)
    smooth = np.convolve(counts, np.ones(3), mode="same")
    k = int(np.argmax(smooth))
    slab = np.abs(height - 0.5 * (edges[k] + edges[k + 1])) < _CAP_SLAB
    return float(np.average(height[slab], weights=weight[slab]))


def long_axis(limb: Sequence[Triangles]) -> Array:
    """Unit direction along a limb: the long axis of its skin, along which a probe is placed by eye.

    The skin of a short limb is wider than long: then the axis of the largest bone that is elongated; if there
    is none, the principal axis of the skin closest to the direction of the head. (A fibula, the most
    elongated bone, lies 4 to 9 degrees across the leg.)

    limb : the skin first, then any known bones; patient LPS
    """
    skin, *bones = limb
    for body in (skin, *sorted(bones, key=lambda each: -each.areas.sum())):
        axis, elongated = principal_axis(body)
        if elongated >= _ELONGATED:
            return axis
    axes = _principal(skin)[1]
    return np.asarray(axes[:, np.argmax(np.abs(HEAD @ axes))])


def principal_axis(surface: Triangles) -> tuple[Array, float]:
    """Unit direction of the largest extent of a surface's area, and its elongation (>= 1)."""
    values, vectors = _principal(surface)
    return vectors[:, 2], float(np.sqrt(values[2] / max(values[1], 1e-12)))


def _principal(surface: Triangles) -> tuple[Array, Array]:
    """Second moments of a surface's area about its centroid, ascending, and their directions in columns."""
    weight = surface.areas
    centred = surface.centroids - np.average(surface.centroids, axis=0, weights=weight)
    values, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred)
    return values, vectors
