"""Where a socket sits on its limb: rigid alignment by landmarks, or to the shape of the skin.

Source: Kabsch 1976, Acta Cryst. A32, 922 (rotation of landmarks); Chen and Medioni 1992, Image Vis. Comput.
10, 145 (point to plane).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import MeshError
from limbcli.meshing.mending import open_rims
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array
from limbcli.sockets.centre_line import CentreLine
from limbcli.sockets.nearest import NearestPoints

_STARTS = 12  # around the limb
_COARSE, _FINE = 300, 2000  # points that are compared
_ROUNDS, _MORE_ROUNDS = 25, 30
_TRIM = 0.9  # share of the points, the nearest, that count: brims reach beyond the limb
_OTHER_DEG = 20.0  # a start that ends further away than this is another alignment
_AS_GOOD = 1.1, 0.1  # residual up to which it is as good: factor, and mm
_MOST_LANDMARK_MM = 15.0
_LEAST_SPREAD_MM = 10.0
_MIRRORED = 0.7  # of the distance from the skin that a socket's mirror image must have to be told of


@dataclass(frozen=True, eq=False)
class Alignment:
    """transform (4, 4) : from the socket's frame to the limb's
    rms_mm, largest_mm : distance of landmarks, or of the inner face from the skin, afterwards
    turned_deg : rotation
    height_mm : of an alignment by shape, how far it may be moved along the limb either way, turned and
        shifted with it, until the residual is 0.1 mm larger
    """

    transform: Array
    rms_mm: float
    largest_mm: float
    turned_deg: float
    height_mm: float | None = None

    @property
    def sentence(self) -> str:
        words = (
            f"socket aligned by a rotation of {self.turned_deg:.1f} degrees: residual {self.rms_mm:.1f} mm "
            f"rms, {self.largest_mm:.1f} mm at most"
        )
        if self.height_mm is None:
            return words
        return (
            f"{words}. Its shape tells its height to {self.height_mm:.1f} mm either way: a tight socket "
            "lands lower, a loose one higher than it is worn, which changes the pressures when donned"
        )


def by_landmarks(
    socket: Array, limb: Array, *, names: Sequence[str] = (), where: str = "landmarks"
) -> Alignment:
    """The rigid transform that takes landmarks (n, 3) of the socket to the limb's, by least squares.

    names : of the landmarks, for messages; default: their numbers

    Raises MeshError if there are fewer than three, they lie in a line, or they do not match within 15 mm.
    """
    if len(socket) != len(limb) or len(limb) < 3:
        raise MeshError(
            f"{len(socket)} landmarks of the socket and {len(limb)} of the limb",
            where=where,
            fix="give at least three pairs",
        )
    for points, whose in ((socket, "socket's"), (limb, "limb's")):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1]
        if spread < _LEAST_SPREAD_MM:
            raise MeshError(
                f"the {whose} landmarks lie within {spread:.1f} mm of a line: the rotation is not determined",
                where=where,
                fix="add a landmark beside it",
            )
    transform = _rigid(socket, limb)
    distance = np.linalg.norm(_moved(socket, transform) - limb, axis=1)
    if distance.max() > _MOST_LANDMARK_MM:
        k = int(np.argmax(distance))
        raise MeshError(
            f"landmark {names[k] if names else k + 1} lies {distance[k]:.0f} mm off after alignment",
            where=where,
            fix="check its place and the others', and the side (left or right)",
            distance_mm=float(distance[k]),
        )
    return _alignment(transform, distance)


def mirror_image_warning(face: Triangles, skin: Triangles, landmarks: Array, *, seed: int = 7) -> str:
    """A sentence if the mirror image of a placed face fits the skin better; "" otherwise.

    Three landmarks do not tell a socket from its image in their plane: both are placed without a residual.

    landmarks (n, 3) : on the limb, with which the face was placed; seed : of the points that are compared
    """
    points, near = _samples(face, _FINE, np.random.default_rng(seed)), NearestPoints(skin)
    middle = landmarks.mean(axis=0)
    normal = np.linalg.svd(landmarks - middle)[2][2]
    image = points - 2.0 * ((points - middle) @ normal)[:, None] * normal
    own, mirrored = (_residual(each, near, np.eye(4))[0] for each in (points, image))
    if mirrored >= _MIRRORED * own:
        return ""
    return (
        f"the socket's mirror image lies nearer to the skin ({mirrored:.1f} mm for {own:.1f} mm rms): check "
        "its side (left or right), its axes, and the landmarks"
    )


def align(
    face: Triangles, skin: Triangles, line: CentreLine, *, seed: int = 7, where: str = "--align"
) -> Alignment:
    """The rigid transform that brings an inner face onto the skin, from starts all around the limb.

    face : the inner face (an open sheet) in its own frame, mm
    line : the limb's centre line
    seed : of the points that are compared

    Raises MeshError if the face has no opening that shows its direction, or if alignments more than 20
    degrees apart fit equally well.
    """
    rng = np.random.default_rng(seed)
    along, tip = _direction(face, where)
    samples = _samples(face, _FINE, rng)
    few = samples[: min(_COARSE, len(samples))]
    near = NearestPoints(skin)
    found = []
    for k in range(_STARTS):
        start = _start(along, tip, line, skin, 2 * np.pi * k / _STARTS)
        transform = _to_planes(few, near, start, _ROUNDS)
        found.append((_residual(few, near, transform)[0], transform))
    found.sort(key=lambda each: each[0])
    best = _to_planes(samples, near, found[0][1], _MORE_ROUNDS)
    rms, distance = _residual(samples, near, best)
    limit = max(_AS_GOOD[0] * found[0][0], found[0][0] + _AS_GOOD[1])
    for coarse, other in found[1:]:
        angle = _angle(other @ np.linalg.inv(best))
        if coarse <= limit and angle > _OTHER_DEG:
            raise MeshError(
                f"two alignments {angle:.0f} degrees apart fit equally well ({found[0][0]:.1f} and "
                f"{coarse:.1f} mm rms): the shape does not tell how the socket is turned about the limb",
                where=where,
                fix="give at least three landmarks on both",
                rms_mm=rms,
                angle_deg=angle,
            )
    return replace(_alignment(best, distance), height_mm=_height(samples, near, best, line.along))


def misplaced(face: Triangles, tilt_deg: Sequence[float], shift_mm: Sequence[float]) -> Triangles:
    """A face in the upright frame (z up) turned about x and y through its centre, then shifted along them."""
    centre = np.average(face.centroids, axis=0, weights=face.areas)
    turn = _about(np.eye(3)[1], np.radians(tilt_deg[1])) @ _about(np.eye(3)[0], np.radians(tilt_deg[0]))
    moved = (face.points - centre) @ turn.T + centre + np.array([*shift_mm, 0.0])
    return Triangles(moved, face.faces)


def _direction(face: Triangles, where: str) -> tuple[Array, Array]:
    """Unit direction towards the closed end of a face, and its point there."""
    rims = open_rims(face)
    if not rims:
        raise MeshError(
            "the inner face is closed all around: it does not tell where the limb enters",
            where=where,
            fix="give the inner face with its opening, or landmarks",
        )
    middle = np.average(face.centroids, axis=0, weights=face.areas)
    along = middle - rims[0][0]
    along /= np.linalg.norm(along)
    return along, face.points[int(np.argmax(face.points @ along))]


def _samples(face: Triangles, count: int, rng: np.random.Generator) -> Array:
    """Points spread evenly over the area of a surface."""
    facets = rng.choice(len(face.faces), size=count, p=face.areas / face.areas.sum())
    s, t = rng.uniform(size=(2, count))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    a, b, c = np.moveaxis(face.corners[facets], 1, 0)
    return np.asarray(a + s[:, None] * (b - a) + t[:, None] * (c - a))


def _start(along: Array, tip: Array, line: CentreLine, skin: Triangles, angle: float) -> Array:
    """The socket's direction along the limb's, its tip at the limb's, turned by an angle (rad)."""
    turn = _about(line.along, angle) @ _onto(along, line.along)
    aim = skin.points[int(np.argmax(skin.points @ line.along))]
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, aim - turn @ tip
    return transform


def _to_planes(points: Array, near: NearestPoints, start: Array, rounds: int) -> Array:
    """Iterated closest points, moved onto the tangent planes of the skin."""
    transform = start
    for _ in range(rounds):
        A, b, middle = _distances(_moved(points, transform), near)
        step = np.asarray(np.linalg.solve(_held(A), A.T @ b), dtype=float)
        size = float(np.linalg.norm(step[:3]))
        turn = _about(step[:3] / size, min(size, 0.3)) if size > 0 else np.eye(3)
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = turn, middle + step[3:] - turn @ middle
        transform = move @ transform
        if size < 1e-5 and np.linalg.norm(step[3:]) < 1e-4:
            break
    return transform


def _distances(x: Array, near: NearestPoints) -> tuple[Array, Array, Array]:
    """Of the nearest points among x: how their distances (n,) from the tangent planes of the skin change
    (n, 6) with a turn about their middle (3,) and a shift; those distances; and the middle."""
    nearest, facets = near.of(x)
    away = np.linalg.norm(x - nearest, axis=1)
    kept = away <= np.quantile(away, _TRIM)
    n = near.surface.area_vectors[facets[kept]]
    n = n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
    x, q = x[kept], nearest[kept]
    middle = x.mean(axis=0)
    return np.concatenate([np.cross(x - middle, n), n], axis=1), np.einsum("ij,ij->i", q - x, n), middle


def _held(A: Array) -> Array:
    """A' A (6, 6); a socket that is rotationally symmetric leaves a direction without information."""
    return np.asarray(A.T @ A + 1e-6 * np.trace(A.T @ A) / 6 * np.eye(6))


def _residual(points: Array, near: NearestPoints, transform: Array) -> tuple[float, Array]:
    """Root mean square distance (mm) of the nearest 90 %, and their distances."""
    x = _moved(points, transform)
    away = np.sort(np.linalg.norm(x - near.of(x)[0], axis=1))[: int(_TRIM * len(x))]
    return float(np.sqrt((away**2).mean())), away


def _height(points: Array, near: NearestPoints, placed: Array, along: Array) -> float:
    """How far (mm) placed points may move along a direction, with the motion across it and the turn that fit
    best, until their root mean square distance from the tangent planes of the skin is 0.1 mm larger."""
    A, b = _distances(_moved(points, placed), near)[:2]
    inverse = np.linalg.inv(_held(A))[3:, 3:]
    rms, stiffness = float(np.sqrt((b**2).mean())), 1.0 / float(along @ inverse @ along)
    return float(np.sqrt(((rms + _AS_GOOD[1]) ** 2 - rms**2) * len(b) / stiffness))


def _alignment(transform: Array, distance: Array) -> Alignment:
    rms = float(np.sqrt((distance**2).mean()))
    return Alignment(transform, rms, float(distance.max()), _angle(transform))


def _rigid(moving: Array, fixed: Array) -> Array:
    a, b = moving - moving.mean(axis=0), fixed - fixed.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    transform = np.eye(4)
    transform[:3, :3] = vt.T @ mirror @ u.T
    transform[:3, 3] = fixed.mean(axis=0) - transform[:3, :3] @ moving.mean(axis=0)
    return transform


def _moved(points: Array, transform: Array) -> Array:
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])


def _angle(transform: Array) -> float:
    cosine = 0.5 * (np.trace(transform[:3, :3]) - 1.0)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _about(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about a unit axis by an angle (rad)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def _onto(a: Array, b: Array) -> Array:
    """The smallest rotation (3, 3) that takes the unit vector a to b."""
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-9:
        side = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        return _about(side / np.linalg.norm(side), 0.0 if cosine > 0 else np.pi)
    return _about(axis / sine, float(np.arctan2(sine, cosine)))
