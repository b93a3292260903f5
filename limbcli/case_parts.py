"""What a case consists of: probe, images, sites and how they were measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Probe:
    """Rigid ultrasound probe; its face is a rounded rectangle (mm)."""

    name: str
    length: float
    width: float
    edge_radius: float


@dataclass(frozen=True)
class Imaging:
    """Where the geometry comes from: an MRI series, a label map, or closed surfaces."""

    mri: Path | None = None
    labels: Path | None = None
    skin: Path | None = None
    bones: tuple[Path, ...] = ()


@dataclass(frozen=True)
class ModelOptions:
    """margin : mm of tissue kept beyond the probe face; element : "tet10" or "tet4"."""

    margin: float = 40.0
    element: str = "tet10"


@dataclass(frozen=True)
class Noise:
    """One standard deviation each (`layer`: mm, of a thickness); `source` says where they come from."""

    force: float = 0.1
    depth: float = 0.3
    swe_level_fraction: float = 0.05
    swe_pixel_fraction: float = 0.10
    source: str = "assumed"
    layer: float = 0.2


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
    """

    name: str
    position: tuple[float, float, float] | None
    marker: int | None
    long_axis: str | tuple[float, float, float]
    levels: Path
    trace: Path | None
    swe_maps: Path | None
    density_kg_per_m3: float
    noise: Noise
    instruments: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    layers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
