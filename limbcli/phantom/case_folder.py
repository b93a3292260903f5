"""Text of case.toml and truth.toml."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Probe
from limbcli.model import Array
from limbcli.phantom.subject import PhantomSite, Subject
from limbcli.version import __version__

PROBE = Probe(name="GE 9L", length=53.0, width=14.0, edge_radius=3.0)
LEVELS_HEADER = "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels,phase,hold_s,skin_bone_mm\n"


@dataclass(frozen=True)
class NoiseLaw:
    """Standard deviations of the noise, named as in [site.noise] of case.toml."""

    force_n: float = 0.1
    depth_mm: float = 0.3
    swe_level_fraction: float = 0.05
    swe_pixel_fraction: float = 0.10
    layer_mm: float = 0.2

    def times(self, factor: float) -> NoiseLaw:
        return NoiseLaw(*(factor * each for each in (
            self.force_n, self.depth_mm, self.swe_level_fraction, self.swe_pixel_fraction, self.layer_mm
        )))  # fmt: skip


def toml(table: Mapping[str, Any], *, name: str = "") -> str:
    """A table as TOML text: plain values first, then tables and lists of tables.

    >>> print(toml({"format": 1, "probe": {"length_mm": 53.0}, "site": [{"name": "p1"}]}))
    format = 1
    <BLANKLINE>
    [probe]
    length_mm = 53.0
    <BLANKLINE>
    [[site]]
    name = "p1"
    <BLANKLINE>
    """
    lines, after = [], []
    for key, value in table.items():
        path = f"{name}.{key}" if name else key
        if isinstance(value, Mapping):
            after.append(f"\n[{path}]\n" + toml(value, name=path))
        elif isinstance(value, Sequence) and value and isinstance(value[0], Mapping):
            after += [f"\n[[{path}]]\n" + toml(each, name=path) for each in value]
        else:
            lines.append(f"{key} = {_plain(value)}\n")
    return "".join(lines + after)


def _plain(value: Any) -> str:
    """
    >>> print(_plain('a\\tb "q" é'), _plain(0.1 + 0.2), _plain([True, 2]))
    "a\\tb \\"q\\" é" 0.3 [true, 2]
    """
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, str | Path):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(round(float(value), 9))
    return "[" + ", ".join(_plain(each) for each in value) + "]"


def case_table(
    *, subject_id: str, imaging: Mapping[str, Any], sites: Sequence[Mapping[str, Any]], element: str = "tet10"
) -> dict[str, Any]:
    """Content of case.toml, in the order of the case format."""
    return {
        "format": 1,
        "subject": {"id": subject_id, "limb": "left"},
        "imaging": dict(imaging),
        "probe": {
            "name": PROBE.name,
            "length_mm": PROBE.length,
            "width_mm": PROBE.width,
            "edge_radius_mm": PROBE.edge_radius,
        },
        "model": {"margin_mm": 40.0, "element": element},
        "site": [dict(each) for each in sites],
    }


def site_table(
    place: PhantomSite, subject: Subject, *, marker: int | None, noise: NoiseLaw | None, measured: bool
) -> dict[str, Any]:
    """One [[site]], placed by the marker with that number or, without one, by its position."""
    table: dict[str, Any] = {"name": place.name}
    if marker is not None:
        table["marker"] = marker
    else:
        table["position_mm"] = [round(float(each), 1) for each in subject.position(place)]
    table["long_axis"] = place.long_axis
    table["levels"] = f"{place.name}/levels.csv"
    if measured:
        table["trace"] = f"{place.name}/trace.csv"
        table["swe_maps"] = f"{place.name}/swe"
    table["density_kg_per_m3"] = 1000.0
    if noise is not None:
        table["noise"] = {**vars(noise), "source": "spec"}
    return table


def geometry_truth(subject: Subject, *, seed: int, dice_labels: str) -> dict[str, Any]:
    """The subject's true geometry, for truth.toml."""

    def rounded(values: Array) -> list[float]:
        return [round(float(each), 4) for each in np.asarray(values).ravel()]

    anatomy = subject.anatomy
    return {
        "made_by": f"limbcli phantom {__version__}",
        "seed": seed,
        "frame": "patient LPS, mm",
        "labels": dice_labels,
        "patient_from_limb": rounded(subject.patient_from_limb),
        "skin_thickness_mm": round(anatomy.skin_thickness, 4),
        "fat_thickness_mm": round(anatomy.fat_thickness, 4),
        "marker": [{"position_mm": rounded(each)} for each in subject.marker_positions()],
        "place": [
            {"name": each.name, "position_mm": rounded(subject.position(each))} for each in subject.places
        ],
    }
