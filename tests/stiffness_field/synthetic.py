"""A synthetic limb (tapered tube with a rounded end and one bone), sites on it, and known fields of c."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from limbcli.meshing.surfaces import Triangles
from limbcli.stiffness_field.coordinates import LimbCoordinates, limb_coordinates
from limbcli.stiffness_field.forces import ForceOf, ForceReading
from limbcli.stiffness_field.likelihood import Interval
from limbcli.stiffness_field.readings import SiteReading, region_below

LENGTH, RADIUS, BONE = 220.0, 50.0, 13.0
AXIS = np.array([0.0, 0.0, 1.0])


def tube(radius: Callable[[np.ndarray], np.ndarray], low: float, high: float, n: int = 48) -> Triangles:
    """A closed surface of revolution about z."""
    z = np.linspace(low, high, 60)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = radius(z)[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([ring, np.broadcast_to(z[:, None, None], (*ring.shape[:2], 1))], axis=2)
    at = np.arange(points.shape[0] * n).reshape(-1, n)
    a, b, c, d = at[:-1], np.roll(at, -1, 1)[:-1], at[1:], np.roll(at, -1, 1)[1:]
    faces = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (b, d, c))])
    flat = points.reshape(-1, 3)
    ends = np.array([[0, 0, low], [0, 0, high]])
    n0, n1 = len(flat), len(flat) + 1
    caps = [(at[0, (k + 1) % n], at[0, k], n0) for k in range(n)]
    caps += [(at[-1, k], at[-1, (k + 1) % n], n1) for k in range(n)]
    return Triangles(np.concatenate([flat, ends]), np.concatenate([faces, np.array(caps)]))


def skin_radius(z: np.ndarray) -> np.ndarray:
    """Rounded over the distal 40 mm, then slowly wider."""
    dome = np.sqrt(np.clip(1 - ((40.0 - np.minimum(z, 40.0)) / 40.0) ** 2, 0.02, 1))
    return (RADIUS - 8 + 8 * z / LENGTH) * dome


SKIN = tube(skin_radius, 0.0, LENGTH)
BONES = [tube(lambda z: np.full_like(z, BONE), 35.0, LENGTH).moved(
    np.array([[1, 0, 0, 0], [0, 1, 0, -12], [0, 0, 1, 0], [0, 0, 0, 1.0]]))]  # fmt: skip


def coordinates(*, bones: Sequence[Triangles] = BONES) -> LimbCoordinates:
    return limb_coordinates(SKIN, bones, AXIS)


def region(height: float, angle_deg: float) -> np.ndarray:
    """The tissue below a probe laid along the limb, at a height (mm) and angle (0 anterior, 90 left)."""
    angle = np.radians(angle_deg)
    normal = np.array([np.sin(angle), -np.cos(angle), 0.0])
    skin = skin_radius(np.array(height)) * normal + height * AXIS
    along = np.linspace(0, 40, 400)
    middle = np.array([0.0, -12.0])
    bone = np.linalg.norm((skin - along[:, None] * normal)[:, :2] - middle, axis=1) - BONE
    deep = float(along[np.argmax(bone < 0)]) if (bone < 0).any() else 35.0
    return region_below(skin, normal, AXIS, length=50.0, skin_bone=deep)


EIGHT = [(60, 0), (60, 130), (60, 240), (110, 60), (110, 180), (160, 0), (160, 120), (160, 260)]


def site(name: str, points: np.ndarray, c: float, deviation: float, **others: Interval) -> SiteReading:
    """c (MPa) with a symmetric interval in ln."""
    reach = 1.959964 * deviation
    ends = Interval(c, float(c * np.exp(-reach)), float(c * np.exp(reach)))
    return SiteReading(name, points, {"c": ends, **others})


DEPTHS = np.array(
    [[1.0, 0.6, 0.02], [3.0, 0.8, 0.06]]
)  # force (N), influence of f_kappa and of m, at two depths


def force_of(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln force (2,) of a tissue, ln of c (MPa), m, f_kappa, and its slopes (2, 3), as tissue has it: m has
    little influence near 1, f_kappa little where it is large or small."""
    force, of_f_kappa, of_m = DEPTHS.T
    tight, stiffening = 1.0 / (1.0 + np.exp(2.0 - 0.7 * logs[2])), of_m * np.exp(logs[1])
    value = np.log(force / 0.008) + logs[0] + stiffening + of_f_kappa * tight
    return value, np.column_stack([np.ones(2), stiffening, 0.7 * of_f_kappa * tight * (1.0 - tight)])


def with_force(read: SiteReading, tissue: np.ndarray, *, noise: float, gain: float = 0.0, off: float = 0.0):
    """The site with the force of a tissue (c in MPa, m, f_kappa), and its noise as a fraction.

    gain : standard deviation of ln of the error of its model; off : that error
    """
    return replace(
        read, force=force_reading(force_of, np.exp(force_of(np.log(tissue))[0] + off), noise=noise, gain=gain)
    )


def force_reading(predict: ForceOf, forces: np.ndarray, *, noise: float, gain: float) -> ForceReading:
    """Forces at two depths with noise (a fraction) and an error of the model (standard deviation of ln)."""
    return ForceReading(
        contact_penalty=20.0,
        depths=np.array([2.0, 4.0]), fitted=forces, noise=noise * forces, limb_over_site=np.ones(2),
        model_errors=np.full((1, 2), gain), predict=predict,
    )  # fmt: skip


def tissue_points(n: int, rng: np.random.Generator) -> np.ndarray:
    """Points evenly in the soft tissue."""
    kept = np.empty((0, 3))
    while len(kept) < n:
        tried = rng.uniform([-RADIUS, -RADIUS, 0], [RADIUS, RADIUS, LENGTH], (4 * n, 3))
        r = np.hypot(tried[:, 0], tried[:, 1])
        in_bone = (np.hypot(tried[:, 0], tried[:, 1] + 12) < BONE) & (tried[:, 2] > 35)
        kept = np.concatenate([kept, tried[(r < skin_radius(tried[:, 2])) & ~in_bone]])
    return kept[:n]


KINDS = ("smooth", "rough", "gradient", "waves", "groups")


def true_log_c(kind: str, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """ln c (MPa) at points (n, 3): a person's mean, and a variation that no kernel of the field makes.

    smooth, rough : Gaussian (squared exponential, 60 mm; exponential, 100 mm) over x, y, z, not over the
        anatomical coordinates; gradient : along the limb and across it; waves : a few sinusoids; groups : two
        tissues with a border of 15 mm
    """
    mean = np.log(0.008) + 0.5 * rng.standard_normal()
    size = np.exp(rng.uniform(np.log(0.15), np.log(0.6)))  # limbs differ in how much c varies within them
    if kind in ("smooth", "rough"):
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        k = np.exp(-0.5 * (apart / 60.0) ** 2) if kind == "smooth" else np.exp(-apart / 100.0)
        values = np.linalg.cholesky(k + 1e-8 * np.eye(len(k))) @ rng.standard_normal(len(k))
    elif kind == "gradient":
        slope = rng.standard_normal(3) * [1 / 40.0, 1 / 40.0, 1 / 90.0]
        values = (points - [0, 0, LENGTH / 2]) @ slope
    elif kind == "waves":
        waves = rng.standard_normal((5, 3)) * [1 / 50.0, 1 / 50.0, 1 / 80.0]
        phase = rng.uniform(0, 2 * np.pi, 5)
        values = (np.cos(points @ waves.T + phase) * rng.standard_normal(5)).sum(axis=1)
    else:
        way = rng.uniform(0, 2 * np.pi)
        across = points[:, 0] * np.cos(way) + points[:, 1] * np.sin(way) - rng.normal(0, 15)
        values = rng.choice([-1, 1]) * np.tanh(across / 15.0)
    return np.asarray(mean + size * values)


def measured(
    kind: str, points: np.ndarray, rng: np.random.Generator, *, deviation: float = 0.1, shallow: bool = False
) -> tuple[np.ndarray, list[SiteReading]]:
    """True ln c at points, and the readings of eight sites with noise: the means of ln c over their regions.

    shallow : a site's reading weights depths by exp(-2 share of the way to the bone), unlike the model's
    """
    regions = [region(*each) for each in EIGHT]
    values = true_log_c(kind, np.concatenate([points, *regions]), rng)
    weights = np.exp(-2 * np.repeat([0.1, 0.3, 0.5, 0.7, 0.9], 3) * shallow)  # as `region_below` orders them
    at_sites = values[len(points) :].reshape(len(regions), -1) @ (weights / weights.sum())
    readings = np.exp(at_sites + deviation * rng.standard_normal(len(regions)))
    sites = [
        site(f"p{k}", where, float(c), deviation)
        for k, (where, c) in enumerate(zip(regions, readings, strict=True))
    ]
    return values[: len(points)], sites
