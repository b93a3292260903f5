"""Anatomy, its pose in the scanner, and the image grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from limbcli.model import Array
from limbcli.phantom.anatomy import Anatomy, random_anatomy
from limbcli.phantom.mri import VoxelGrid
from limbcli.phantom.shapes import project

LENGTH = 156.0  # length of limb in the image (mm)
SITE_HEIGHT = 84.0
AIR = 9.0  # width of air around the limb and its markers (mm)


@dataclass(frozen=True, eq=False)
class PhantomSite:
    """A site of the phantom: its position on the limb (angle about the axis, height), and the probe's
    orientation."""

    name: str
    angle_deg: float
    height: float
    long_axis: str
    by_marker: bool


PLACES = (
    PhantomSite("p1", angle_deg=97.0, height=SITE_HEIGHT, long_axis="transverse", by_marker=True),
    PhantomSite("p2", angle_deg=28.0, height=SITE_HEIGHT - 4.0, long_axis="axial", by_marker=False),
)


@dataclass(frozen=True, eq=False)
class Subject:
    """A limb in a scanner. Positions and directions are in the patient frame (LPS, mm)."""

    anatomy: Anatomy
    patient_from_limb: Array
    grid: VoxelGrid
    places: tuple[PhantomSite, ...]

    @property
    def limb_from_patient(self) -> Array:
        return np.asarray(np.linalg.inv(self.patient_from_limb), dtype=float)

    def to_patient(self, points: Array) -> Array:
        return points @ self.patient_from_limb[:3, :3].T + self.patient_from_limb[:3, 3]

    def position(self, place: PhantomSite) -> Array:
        """The site's point on the skin, in the patient frame."""
        point, _ = self.anatomy.skin_point(angle_deg=place.angle_deg, height=place.height)
        return self.to_patient(point[None])[0]

    def marker_positions(self) -> Array:
        return self.to_patient(np.array([each.center for each in self.anatomy.markers]))


def make_subject(
    rng: np.random.Generator,
    *,
    voxel: tuple[float, float, float] = (1.0, 1.0, 4.0),
    places: tuple[PhantomSite, ...] = PLACES,
) -> Subject:
    """A random limb, slightly rotated, in an oblique image that just contains it.

    It has two markers: at the first place, and at the front, further proximal.
    """
    anatomy = random_anatomy(rng)
    marked = next((each for each in places if each.by_marker), places[0])
    anatomy = anatomy.with_marker(angle_deg=marked.angle_deg, height=marked.height)
    anatomy = anatomy.with_marker(angle_deg=-118.0, height=SITE_HEIGHT + 36.0)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", rng.uniform(-5, 5, 3), degrees=True).as_matrix()
    pose[:3, 3] = np.array([92.0, 14.0, -418.0]) + rng.uniform(-8, 8, 3)
    oblique = Rotation.from_euler("xyz", rng.uniform(3, 8, 3) * rng.choice([-1, 1], 3), degrees=True)
    axes = (Rotation.from_matrix(pose[:3, :3]) * oblique).as_matrix().T
    return Subject(
        anatomy=anatomy,
        patient_from_limb=pose,
        grid=_grid_around(anatomy, pose, axes, np.array(voxel)),
        places=places,
    )


def _grid_around(anatomy: Anatomy, pose: Array, axes: Array, spacing: Array) -> VoxelGrid:
    """The smallest grid along `axes` that contains `LENGTH` of the limb, its markers and some air."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(2.0, LENGTH, 40))
    ring = np.stack([40 * np.cos(angle).ravel(), 36 * np.sin(angle).ravel(), height.ravel()], axis=1)
    outline = [project(anatomy.skin, ring), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, LENGTH]])]
    outline += [each.center + each.radius * np.vstack([np.eye(3), -np.eye(3)]) for each in anatomy.markers]
    along = (np.vstack(outline) @ pose[:3, :3].T + pose[:3, 3]) @ axes.T
    low, high = along.min(axis=0) - AIR, along.max(axis=0) + AIR
    tip = (np.array([0.0, 0.0, 0.0]) @ pose[:3, :3].T + pose[:3, 3]) @ axes[2]
    low[2], high[2] = min(low[2], tip - AIR), tip + LENGTH
    shape = np.ceil((high - low) / spacing).astype(int)
    return VoxelGrid(
        origin=(low + spacing / 2) @ axes, axes=axes, spacing=spacing, shape=(shape[0], shape[1], shape[2])
    )
