"""The case folder, format 1: what a user brings.

`Case.open(folder)` reads and checks `case.toml` and everything it names that can
be checked without computing, and reports every problem at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from limbcli.model import Array


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
    margin: float = 40.0
    element: str = "tet10"


@dataclass(frozen=True)
class Noise:
    """One standard deviation each."""

    force: float = 0.1
    depth: float = 0.3
    swe_level_fraction: float = 0.05
    swe_pixel_fraction: float = 0.10
    source: str = "assumed"


@dataclass(frozen=True, eq=False)
class Site:
    """A place, a probe orientation and one measurement.

    position : (3,) mm patient LPS, or None where `marker` (from 1) is given
    long_axis : "transverse", "axial", or a vector (3,)
    levels : the path of levels.csv
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


@dataclass(frozen=True, eq=False)
class Case:
    folder: Path
    subject: str
    limb: str
    imaging: Imaging
    probe: Probe
    model: ModelOptions
    sites: tuple[Site, ...]
    raw: Mapping[str, object]
