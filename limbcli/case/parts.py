"""What a case consists of: probe, images, sites and how they were measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.model import Array

NOT_IMAGED = "geometry assumed, not imaged"
# Of a scan, one deviation. Chosen: limits of agreement of scanned perimeters are below 3.5 %, two deviations
# (Cutti et al. 2024, Sensors 24:2350).
SKIN_SCALE = 0.01


@dataclass(frozen=True)
class Probe:
    """Rigid ultrasound probe; its face is a rounded rectangle (mm)."""

    name: str
    length: float
    width: float
    edge_radius: float


@dataclass(frozen=True)
class Shape:
    """A limb in numbers (mm): a straight round tube, its layers from the skin to one round bone.

    The site lies in front (-y of LPS), the bone as deep below it as the layers are thick.
    """

    circumference: float
    skin: float
    fat: float
    muscle: float
    bone_radius: float

    @property
    def radius(self) -> float:
        return self.circumference / (2.0 * pi)

    @property
    def skin_bone(self) -> float:
        """From the skin to the bone: the sum of the layers.

        >>> Shape(314.159, 1.5, 6.5, 18.0, 14.0).skin_bone
        26.0
        """
        return self.skin + self.fat + self.muscle

    @property
    def place(self) -> tuple[float, float, float]:
        """Of a site whose place nobody gives: in front, half-way along."""
        return (0.0, -self.radius, 0.0)


@dataclass(frozen=True)
class Imaging:
    """Where the geometry comes from: an MRI series, a label map, surfaces, or what was measured outside.

    bone_radius : mm, of a bone that no file shows, as deep as ultrasound sees it; None: a file shows it
    shape : numbers only
    skin_scale : one deviation of the scale of a scanned skin, as a share of it
    fibres : NIfTI of fibre directions of the whole limb; fibre_frame : of its components, "ras" where None
    """

    mri: Path | None = None
    labels: Path | None = None
    skin: Path | None = None
    bones: tuple[Path, ...] = ()
    bone_radius: float | None = None
    shape: Shape | None = None
    fibres: Path | None = None
    fibre_frame: str | None = None
    skin_scale: float = SKIN_SCALE

    @property
    def assumed(self) -> str:
        """What of the geometry nobody has seen, in words for every page; nothing where it was imaged.

        >>> Imaging(skin=Path("scan.stl"), bone_radius=14.0).assumed[:66]
        'geometry assumed, not imaged: the bone is a straight round rod of '
        >>> Imaging(mri=Path("mri")).assumed
        ''
        """
        if self.shape is not None:
            one = self.shape
            return (
                f"{NOT_IMAGED}: a straight round limb of {one.circumference:g} mm circumference, "
                f"{one.skin_bone:g} mm from skin to bone (skin {one.skin:g}, fat {one.fat:g}, muscle "
                f"{one.muscle:g}), one round bone of {one.bone_radius:g} mm radius"
            )
        if self.bone_radius is None:
            return ""
        return (
            f"{NOT_IMAGED}: the bone is a straight round rod of {self.bone_radius:g} mm radius, at "
            "the depth measured by ultrasound below each site; the skin is a scan"
        )


@dataclass(frozen=True)
class Pennation:
    """The angle of muscle fibres in the plane of an ultrasound image, as B-mode shows it.

    orientation : of the probe that made the image: "axial", "transverse", or the name of a site there
    angle_deg : from the image's lateral axis, positive where fibres go deeper as lateral grows
    deviation_deg : one standard deviation
    """

    orientation: str
    angle_deg: float
    deviation_deg: float = 5.0


@dataclass(frozen=True)
class Fibres:
    """What a case gives for the fibres at a site: a direction (patient LPS, any length), or image angles."""

    direction: tuple[float, float, float] | None = None
    pennation: tuple[Pennation, ...] = ()

    @property
    def given(self) -> bool:
        return self.direction is not None or bool(self.pennation)


@dataclass(frozen=True)
class Stretch:
    """Of tissue, along and around the limb (1): a ratio of lengths; None where it is not known."""

    along: float | None = None
    around: float | None = None


@dataclass(frozen=True)
class StretchState:
    """One of several ways in which a place was stretched while it was measured.

    stretch : lengths over those in a state of the user's choice, the same for all; levels : its levels.csv
    """

    name: str
    stretch: Stretch
    levels: Path


@dataclass(frozen=True)
class ModelOptions:
    """margin : mm of tissue kept beyond the probe face; element : "tet10" or "tet4"."""

    margin: float = 40.0
    element: str = "tet10"


@dataclass(frozen=True)
class StatedNoise:
    """One standard deviation each (`layer`: mm, of a thickness); `source` says where they come from."""

    force: float = 0.1
    depth: float = 0.3
    swe_level_fraction: float = 0.05
    swe_pixel_fraction: float = 0.10
    source: str = "assumed"
    layer: float = 0.2

    def of_mean_speed(self, pixels: Array) -> Array:
        """One deviation of ln of a level's mean speed (n,), by its number of pixels (n,).

        Where that is not given, the pixels' own share is left out beside one common to them all; without
        such it is that of one pixel: a reading is never exact for want of a count.

        >>> StatedNoise().of_mean_speed(np.array([100.0, np.nan])).round(4)
        array([0.051, 0.05 ])
        >>> StatedNoise(swe_level_fraction=0.0).of_mean_speed(np.array([100.0, np.nan]))
        array([0.01, 0.1 ])
        """
        unknown = np.inf if self.swe_level_fraction > 0 else 1.0
        own = self.swe_pixel_fraction / np.sqrt(np.where(np.isfinite(pixels), pixels, unknown))
        return np.hypot(self.swe_level_fraction, own)


@dataclass(frozen=True, eq=False)
class Site:
    """A place, a probe orientation and one measurement.

    position : (3,) mm patient LPS, or None where `marker` (from 1) is given
    long_axis : "transverse", "axial", or a vector (3,)
    levels, trace, swe_maps : paths of levels.csv, trace.csv, and the folder of SWE maps
    instruments : tables "load_cell", "b_mode", "swe_images" for `limbcli measure`, with
        defaults filled in and `path` added (a trace is a load cell's record too); where there are any,
        levels.csv and the folder of SWE maps may be missing
    layers : tables "skin" and "fat": `thickness_mm` (or "mri") and the law; what is not given is None
    skin_bone : mm from skin to bone along the beam at first touch, where it is given by hand
    fibres : of the muscle, as far as the case gives them
    states : where it was measured in several; `levels` is then that of the first, whose shape the images show
    unloaded : stretches, counted as those of the states, at which the tissue is known to be unloaded
    """

    name: str
    position: tuple[float, float, float] | None
    marker: int | None
    long_axis: str | tuple[float, float, float]
    levels: Path
    trace: Path | None
    swe_maps: Path | None
    density_kg_per_m3: float
    noise: StatedNoise
    instruments: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    layers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    skin_bone: float | None = None
    fibres: Fibres = field(default_factory=Fibres)
    states: tuple[StretchState, ...] = ()
    unloaded: Stretch = Stretch()
