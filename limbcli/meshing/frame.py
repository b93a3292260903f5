"""The frame of a site: its position on the skin, its outward normal and its long axis.

The origin lies on the skin at first touch, z points outward along the mean skin normal under the probe, x
along the probe's long side, y = z x x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.mending import Limb, long_axis
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array
from limbcli.model.patient_frame import side_of, toward_head

FAR_FROM_SKIN = 30.0  # mm: a site farther than this from the skin is an error
_PLAN = 0.5  # mm between the points of the face at which first touch is looked for
_LOWEST = -60.0  # mm: skin farther below the frame's origin is that of the other side
# Largest angle (deg) between a given long axis and the skin at which the axis is still taken as the probe's
# own: what hand-held placement gives (the prior of a tilt). At larger angles only its projection on the skin
# is used.
LARGEST_SLOPE_DEG = 10.0


@dataclass(frozen=True, eq=False)
class SiteFrame:
    """to_model (4, 4): patient LPS to the site's frame; all else in LPS, mm.

    slope_deg : angle of the given long axis to the skin's mean plane under the probe; 0 for "axial" and
        "transverse", which lie in that plane
    """

    to_model: Array
    skin_point: Array
    normal: Array
    long_axis: Array
    proximal: Array
    moved: float
    slope_deg: float = 0.0

    @property
    def to_patient(self) -> Array:
        return np.asarray(np.linalg.inv(self.to_model), np.float64)

    @property
    def sides(self) -> tuple[str, str]:
        """The sides of the patient towards which x and y of the site's frame point."""
        return side_of(self.to_model[0, :3]), side_of(self.to_model[1, :3])


def proximal_direction(limb: Limb) -> Array:
    """Unit vector along the limb (`long_axis`) towards the head: oriented to +z of LPS."""
    return toward_head(long_axis([limb.skin, *limb.bones]))


def site_frame(
    limb: Limb,
    position: Array,
    long_axis: str | tuple[float, float, float],
    probe: ProbeShape,
    *,
    where: str = "site",
) -> SiteFrame:
    """The frame of a site on a repaired limb in the patient frame.

    The site is the nearest skin point; the face's height is that of first touch. The probe is normal to the
    skin: along its area-weighted mean normal over the footprint. A long axis given as a vector is kept as
    measured, and the probe is made normal to the skin only across it; an axis that deviates from the skin
    plane by more than `LARGEST_SLOPE_DEG` is projected onto it.

    Raises CaseError if the position is more than 30 mm from the skin, or the long axis is parallel to the
    normal.
    """
    point, normal, distance = nearest_skin_point(limb.skin, np.asarray(position, float))
    if distance > FAR_FROM_SKIN:
        raise CaseError(
            f"the site lies {distance:.0f} mm from the skin",
            where=where,
            fix="give position_mm on the skin, in mm, patient LPS",
            distance_mm=distance,
        )
    proximal = proximal_direction(limb)
    for _ in range(4):
        x = probe_axis(long_axis, proximal, normal, where=where)
        normal = _mean_normal(limb.skin, point, normal, x, probe)
    x, normal, slope_deg = _as_given(long_axis, probe_axis(long_axis, proximal, normal, where=where), normal)
    rotation = np.stack([x, np.cross(normal, x), normal])
    to_model = np.eye(4)
    to_model[:3, :3] = rotation
    to_model[:3, 3] = -rotation @ point
    to_model[2, 3] -= first_touch(limb.skin.moved(to_model), probe)
    return SiteFrame(to_model, point, normal, x, proximal, distance, slope_deg)


def _as_given(
    long_axis: str | tuple[float, float, float], in_skin: Array, normal: Array
) -> tuple[Array, Array, float]:
    """Long axis, the normal perpendicular to it, and the slope (deg) of the given axis to the skin."""
    if isinstance(long_axis, str):
        return in_skin, normal, 0.0
    given = np.asarray(long_axis, float) / np.linalg.norm(long_axis)
    slope_deg = float(np.degrees(np.arcsin(given @ normal)))
    if abs(slope_deg) > LARGEST_SLOPE_DEG:
        return in_skin, normal, slope_deg
    upright = normal - (normal @ given) * given
    return given, upright / np.linalg.norm(upright), slope_deg


def probe_axis(
    long_axis: str | tuple[float, float, float], proximal: Array, normal: Array, *, where: str = "site"
) -> Array:
    """Unit x of the frame, in the skin plane.

    "axial" is proximal, "transverse" proximal x normal; a vector is projected onto the plane.

    >>> probe_axis("transverse", np.array([0.0, 0, 1]), np.array([1.0, 0, 0]))
    array([0., 1., 0.])
    """
    if isinstance(long_axis, str):
        if long_axis not in ("axial", "transverse"):
            raise CaseError(
                f"long_axis {long_axis!r} is not known",
                where=where,
                fix='use "transverse", "axial" or [x, y, z]',
            )
        direction = proximal if long_axis == "axial" else np.cross(proximal, normal)
    else:
        direction = np.asarray(long_axis, float)
    inplane = direction - (direction @ normal) * normal
    size = float(np.linalg.norm(inplane))
    if size < 0.1 * max(float(np.linalg.norm(direction)), 1e-12) or size < 1e-9:
        raise CaseError(
            "the probe's long axis points along the skin normal",
            where=where,
            fix="give long_axis as a vector [x, y, z] that lies in the skin at the site",
        )
    return inplane / size


def nearest_skin_point(skin: Triangles, position: Array) -> tuple[Array, Array, float]:
    """Closest point (3,) of the surface, its face's unit normal, and the distance (mm)."""
    to_points = np.linalg.norm(skin.points - position, axis=1)[skin.faces].min(axis=1)
    # no triangle's point is nearer than its nearest corner less an edge
    near = np.flatnonzero(to_points <= to_points.min() + 1.001 * skin.longest_edge)
    nearest = closest_on_triangles(position, skin.corners[near])
    distance = np.linalg.norm(nearest - position, axis=1)
    k = int(np.argmin(distance))
    normal = skin.area_vectors[near[k]]
    return nearest[k], normal / np.linalg.norm(normal), float(distance[k])


def closest_on_triangles(p: Array, corners: Array) -> Array:
    """The point (m, 3) of every triangle (m, 3, 3) that is closest to p (3,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    u, v, w = b - a, c - a, p - a
    uu, uv, vv = (np.einsum("ij,ij->i", *each) for each in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("ij,ij->i", w, u), np.einsum("ij,ij->i", w, v)
    d = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (vv * wu - uv * wv) / d, (uu * wv - uv * wu) / d
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    best = a + s[:, None] * u + t[:, None] * v
    edges = [_closest_on_segments(p, *each) for each in ((a, b), (b, c), (c, a))]
    sizes = np.stack([np.linalg.norm(each - p, axis=1) for each in edges])
    on_edge = np.stack(edges)[np.argmin(sizes, axis=0), np.arange(len(a))]
    return np.where(inside[:, None], best, on_edge)


def _closest_on_segments(p: Array, a: Array, b: Array) -> Array:
    e = b - a
    t = np.einsum("ij,ij->i", p - a, e) / np.maximum(np.einsum("ij,ij->i", e, e), 1e-30)
    return a + np.clip(t, 0, 1)[:, None] * e


def _mean_normal(skin: Triangles, point: Array, normal: Array, x: Array, probe: ProbeShape) -> Array:
    """Area-weighted mean normal of the outward-facing skin under the footprint."""
    y = np.cross(normal, x)
    relative = skin.centroids - point
    u, v, w = relative @ x, relative @ y, relative @ normal
    area = skin.area_vectors
    under = (np.abs(u) <= probe.length / 2) & (np.abs(v) <= probe.width / 2)
    under &= (area @ normal > 0) & (w > -probe.length / 2)
    if not under.any():
        return normal
    mean = area[under].sum(axis=0)
    return mean / np.linalg.norm(mean)


def first_touch(skin: Triangles, probe: ProbeShape) -> float:
    """Height (mm) at which the face of a probe moving down along z first meets the skin."""
    x, y = probe.plan(_PLAN)
    gap = skin_height(skin, x, y) - probe.rise(x, y)
    if not np.isfinite(gap).any():
        raise MeshError(
            "there is no skin under the probe", where="site", fix="move position_mm onto the limb"
        )
    return float(np.nanmax(gap))


def skin_height(skin: Triangles, x: Array, y: Array) -> Array:
    """Height of the uppermost outward-facing skin at plan points (n,); NaN where there is none."""
    corners = skin.corners[(skin.area_vectors[:, 2] > 0)]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = (high[:, 0] > x.min()) & (low[:, 0] < x.max()) & (high[:, 1] > y.min()) & (low[:, 1] < y.max())
    near &= high[:, 2] > _LOWEST
    out = np.full(len(x), np.nan)
    for a, b, c in corners[near]:
        d = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if d <= 0:
            continue
        s = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / d
        t = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / d
        hit = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
        z = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2])
        out[hit] = np.fmax(out[hit], z[hit])
    return out


def skin_point_at(limb: Limb, angle_deg: float, height: float, *, where: str = "site") -> Array:
    """The skin point (3,) at an angle around the limb and a height above its distal end (mm, along the limb).

    0 degrees is anterior (-y of LPS), 90 the patient's left, seen from the centre of the cross-section at
    that height.

    Raises CaseError if the limb has no skin at that height.
    """
    axis = proximal_direction(limb)
    along = limb.skin.points @ axis
    found = cut_across(limb.skin, axis, float(along.min()) + height)
    if found is None:
        raise CaseError(
            f"there is no skin {height:g} mm above the limb's distal end",
            where=where,
            fix=f"give a height of 0 to {np.ptp(along):.0f} mm",
        )
    middle, corners = found
    direction = around(axis, np.radians(angle_deg))
    hits = ray_hits(middle, direction, corners)
    if not len(hits):
        raise CaseError(f"no skin at {angle_deg:g} degrees", where=where, fix="choose another angle")
    return middle + hits.max() * direction


def around(axis: Array, angle: float) -> Array:
    """Unit vector (3,) across a limb at an angle (rad): 0 anterior, pi/2 the patient's left."""
    anterior = anterior_of(axis)
    return np.asarray(np.cos(angle) * anterior + np.sin(angle) * np.cross(axis, anterior))


def anterior_of(axis: Array) -> Array:
    """Unit vector (3,) across a limb towards anterior, -y of LPS."""
    anterior = np.array([0.0, -1.0, 0.0])
    anterior -= (anterior @ axis) * axis
    return anterior / np.linalg.norm(anterior)


def cut_across(skin: Triangles, axis: Array, height: float) -> tuple[Array, Array] | None:
    """The centre (3,) of a cross section, and the corners (n, 3, 3) of the triangles that it cuts."""
    along = (skin.points @ axis)[skin.faces]
    crossing = (along.min(axis=1) <= height) & (along.max(axis=1) >= height)
    if not crossing.any():
        return None
    cut = skin.part(crossing)
    middle = np.average(cut.centroids, axis=0, weights=cut.areas)
    return middle + (height - middle @ axis) * axis, cut.corners


def ray_hits(start: Array, direction: Array, corners: Array) -> Array:
    """Distances (n,) >= 0 along a ray to its intersections with triangles (m, 3, 3) (Moeller-Trumbore)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, v)
    det = np.einsum("ij,ij->i", u, p)
    safe = np.where(np.abs(det) > 1e-14, det, np.inf)
    t = start - a
    s = np.einsum("ij,ij->i", t, p) / safe
    q = np.cross(t, u)
    r = q @ direction / safe
    distance = np.einsum("ij,ij->i", v, q) / safe
    hit = (s >= -1e-9) & (r >= -1e-9) & (s + r <= 1 + 1e-9) & (distance >= 0) & np.isfinite(safe)
    return distance[hit]
