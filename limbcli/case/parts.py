"""The parts of a case: probe, images, sites and how they were measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

from limbcli.case.label_sources import LabelSource

NOT_IMAGED = "geometry assumed, not imaged"
# Standard deviation of the scale of a scanned skin, as a fraction. Chosen: the limits of agreement (two
# standard deviations) of scanned perimeters are below 3.5 % (Cutti et al. 2024, Sensors 24:2350).
SKIN_SCALE = 0.01


def point(values: Iterable[Any]) -> tuple[float, float, float]:
    """A point's coordinates, or a vector's components."""
    x, y, z = (float(each) for each in values)
    return x, y, z


@dataclass(frozen=True)
class Probe:
    """Rigid ultrasound probe; its face is a rounded rectangle (mm)."""

    name: str
    length: float
    width: float
    edge_radius: float


@dataclass(frozen=True)
class Shape:
    """A limb given by numbers (mm): a straight round tube, its layers from the skin to one round bone.

    The site lies in front (-y of LPS), the bone below it at a depth equal to the thickness of the layers.
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
        """Distance from the skin to the bone: the sum of the layers.

        >>> Shape(314.159, 1.5, 6.5, 18.0, 14.0).skin_bone
        26.0
        """
        return self.skin + self.fat + self.muscle

    @property
    def place(self) -> tuple[float, float, float]:
        """Default position of a site: in front, half-way along the limb."""
        return (0.0, -self.radius, 0.0)


@dataclass(frozen=True, kw_only=True)
class Imaging:
    """Source of the geometry: an MRI series, a label map, surfaces, or external measurements.

    labels : label maps; a path alone is a file or folder that says itself what it contains
    bone_radius : mm, of a bone that no file contains, at the depth seen by ultrasound; None: a file contains
        it
    shape : for a limb given only by numbers
    mm_per_unit : mm of length 1 in the surfaces, as case.toml gives it; None: as the files state it, else 1
    unit : name of that length; empty if it is given as a number
    mirrored : whether the surfaces show the limb of the other side
    skin_scale : standard deviation of the scale of a scanned skin, as a fraction
    fibres : NIfTI of fibre directions of the whole limb; fibre_frame : frame of its components, None means
        "ras"
    """

    mri: Path | None = None
    labels: Path | tuple[LabelSource, ...] = ()
    skin: Path | None = None
    bones: tuple[Path, ...] = ()
    bone_radius: float | None = None
    shape: Shape | None = None
    fibres: Path | None = None
    fibre_frame: str | None = None
    skin_scale: float = SKIN_SCALE
    mm_per_unit: float | None = None
    unit: str = ""
    mirrored: bool = False

    @property
    def label_maps(self) -> tuple[LabelSource, ...]:
        """
        >>> Imaging(labels=Path("a.nii")).label_maps
        (LabelSource(path=PosixPath('a.nii'), preset=None, names={}, titles={}),)
        """
        return self.labels if isinstance(self.labels, tuple) else (LabelSource(self.labels),)

    @property
    def assumed(self) -> str:
        """Description, for every page, of the geometry that was assumed; empty if it was imaged.

        >>> Imaging(skin=Path("scan.stl"), bone_radius=14.0).assumed[:66]
        'geometry assumed, not imaged: the bone is a straight round rod of '
        >>> Imaging(mri=Path("mri")).assumed
        ''
        """
        return self.assumed_shape and f"{NOT_IMAGED}: {self.assumed_shape}"

    @property
    def assumed_shape(self) -> str:
        """The shape that was assumed, in words; empty if all was imaged."""
        if self.shape is not None:
            one = self.shape
            return (
                f"a straight round limb of {one.circumference:g} mm circumference, "
                f"{one.skin_bone:g} mm from skin to bone (skin {one.skin:g}, fat {one.fat:g}, muscle "
                f"{one.muscle:g}), one round bone of {one.bone_radius:g} mm radius"
            )
        if self.bone_radius is None:
            return ""
        return (
            f"the bone is a straight round rod of {self.bone_radius:g} mm radius, at "
            "the depth measured by ultrasound below each site; the skin is a scan"
        )


@dataclass(frozen=True)
class Pennation:
    """The angle of muscle fibres in the plane of a B-mode ultrasound image.

    orientation : of the probe that made the image: "axial", "transverse", or the name of a site at the same
        place
    angle_deg : from the image's lateral axis, positive if fibres get deeper with increasing lateral
        coordinate
    deviation_deg : standard deviation
    """

    orientation: str
    angle_deg: float
    deviation_deg: float = 5.0


@dataclass(frozen=True)
class Fibres:
    """Fibre input of a site: a direction (patient LPS, any length), or image angles."""

    direction: tuple[float, float, float] | None = None
    pennation: tuple[Pennation, ...] = ()

    @property
    def given(self) -> bool:
        return self.direction is not None or bool(self.pennation)


@dataclass(frozen=True)
class Stretch:
    """Stretch of the tissue along and around the limb: ratios of lengths; None if unknown."""

    along: float | None = None
    around: float | None = None


@dataclass(frozen=True)
class StretchState:
    """One of several states of stretch in which a site was measured.

    stretch : lengths relative to a reference state chosen by the user, the same for all; levels : its
        levels.csv
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
    """Standard deviations of the measurements (`layer`: mm, of a thickness); `source` is their origin."""

    force: float = 0.1
    depth: float = 0.3
    swe_level_fraction: float = 0.05
    swe_pixel_fraction: float = 0.10
    source: str = "assumed"
    layer: float = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Site:
    """A position, a probe orientation and one measurement.

    position : (3,) mm patient LPS, or None if `marker` (from 1) is given
    long_axis : "transverse", "axial", or a vector (3,)
    levels, trace, swe_maps : paths of levels.csv, trace.csv, and the folder of SWE maps
    instruments : tables "load_cell", "b_mode", "swe_images" for `limbcli measure`, with defaults filled in
        and `path` added (a trace also counts as a load cell record); if there are any, levels.csv and the
        folder of SWE maps may be missing
    layers : tables "skin" and "fat": `thickness_mm` (or "mri") and the law; values not given are None
    skin_bone : mm from skin to bone along the beam at first touch, if given by hand
    fibres : of the muscle, as far as the case gives them
    states : if it was measured in several; `levels` is then that of the first, whose shape the images show
    unloaded : stretches, relative to the same reference as the states, at which the tissue is known to be
        unloaded
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
