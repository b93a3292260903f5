"""Every key of case.toml with another value: what a small case becomes, and where the value is kept."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from limbcli.case import schema
from tests.stages import chain_case

Table = dict[str, Any]
Change = Callable[[Table], object]


def toml(value: Any) -> str:
    """A value as TOML, tables within braces.

    >>> toml({"a": [1.5, "b"], "c": {"d": True}})
    '{a = [1.5, "b"], c = {d = true}}'
    """
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def write_changed(folder: Path, change: Change) -> None:
    """Change the case of `chain_case`, whose further files are written too."""
    (folder / "mri2").mkdir(exist_ok=True)
    for name in ("IM1", "IM2"):
        (folder / "mri2" / name).write_bytes(b"other")
    (folder / "images").mkdir(exist_ok=True)
    (folder / "images" / "1.png").write_bytes(b"image")
    for name in ("labels.nii.gz", "skin.stl", "bone.stl", "fibres.nii.gz"):
        (folder / name).write_bytes(b"file")
    (folder / "levels2.csv").write_text(chain_case.LEVELS.replace("4,3,2.1", "4,3,2.2"))
    (folder / "trace2.csv").write_text("time_s,force_n\n0,0\n1,2\n")
    content = tomllib.loads(chain_case.CASE)
    change(content)
    lines = [f"{key} = {toml(value)}" for key, value in content.items()]
    (folder / "case.toml").write_text("\n".join(lines) + "\n")


def _in(table: str, **values: Any) -> Change:
    return lambda case: case[table].update(values)


def _instead(table: str, **values: Any) -> Change:
    return lambda case: case.update({table: values})


def _site(**values: Any) -> Change:
    return lambda case: case["site"][0].update(values)


def _by_marker(case: Table) -> None:
    del case["site"][0]["position_mm"]
    case["site"][0]["marker"] = 1


def _states(**unloaded: float) -> Change:
    two = [
        {"name": "short", "stretch_along": 0.9, "stretch_around": 1.0, "levels": "levels.csv"},
        {"name": "long", "stretch_along": 1.1, "stretch_around": 1.0, "levels": "levels2.csv"},
    ]

    def change(case: Table) -> None:
        del case["site"][0]["levels"]
        case["site"][0].pop("trace")
        case["site"][0].update(state=two, **unloaded)

    return change


_OGDEN = {"thickness_mm": "mri", "law": "ogden", "c_kpa": 2.0, "f_kappa": 40.0, "m": 3.0}
_SURFACES: Table = {"skin": "skin.stl", "bones": ["bone.stl"]}
_SCAN = {"skin": "skin.stl", "bone": "from-ultrasound"}
_SHAPE = {"circumference_mm": 300.0, "skin_mm": 1.5, "fat_mm": 6.0, "muscle_mm": 18.0, "bone_radius_mm": 12.0}
_VALUES: dict[str, Table] = {
    "load_cell": {
        "file": "trace2.csv", "columns": {"force": "F"}, "time_unit": "ms", "force_unit": "kN",
        "length_unit": "m", "separator": ";", "decimal": ",", "hold_s": 4.0, "hold_tolerance_n": 0.2,
        "step_n": 1.0, "tare_s": [0.0, 1.0], "probe_mass_kg": 0.3, "axis": "x",
    },
    "b_mode": {
        "folder": "images", "mm_per_pixel": 0.1, "frame": 1, "box_pixels": [0, 0, 9, 9], "bone_mm": 20.0,
        "skin_mm": 1.5, "fat_mm": 6.0,
    },
    "swe_images": {
        "folder": "images", "mm_per_pixel": 0.1, "frame": 1, "image_pixels": [0, 0, 9, 9],
        "box_pixels": [0, 0, 9, 9], "bar_pixels": [0, 0, 2, 9], "low_m_per_s": 0.5, "high_m_per_s": 9.0,
        "low_kpa": 1.0, "high_kpa": 90.0, "preset": "mach30",
        "bar_scale": "modulus", "opacity": 0.5, "roi_depth_mm": [1.0, 9.0], "roi_lateral_mm": [-5.0, 5.0],
    },
}  # fmt: skip
_NEEDED: dict[str, Table] = {
    "load_cell": {"file": "trace.csv"}, "b_mode": {"folder": "images"},
    "swe_images": {"folder": "images", "high_m_per_s": 8.0},
}  # fmt: skip
_INSTEAD: dict[str, Table] = {  # of what is needed
    "high_kpa": {"folder": "images"}, "low_kpa": {"folder": "images", "high_kpa": 80.0},
}  # fmt: skip
_BESIDES: dict[str, Table] = {"probe_mass_kg": {"tare_s": [0.0, 1.0]}}  # what a key needs beside it

_FACE: Table = {"surface": "skin.stl"}
_SOCKET: dict[str, tuple[Any, Table]] = {  # value, and what a key needs beside it
    "surface": ("skin.stl", {}), "align": (True, _FACE), "all_mm": (0.5, {}), "brim_mm": (60.0, {}),
    "landmarks": ({key: [0.0, 0.0, 0.0] for key in ("tibial_end", "fibular_head", "distal_end")}, _FACE),
    "rectifications_mm": ({"patellar_tendon": 2.0}, {}), "transition_mm": (10.0, {}), "flare_mm": (2.0, {}),
    "friction": (0.2, {}), "friction_deviation": (0.05, {}), "loads_n": ([100.0], {}),
    "limb_nodes": (5000, {}), "tilt_deviation_deg": (2.0, {}), "shift_deviation_mm": (2.0, {}),
}  # fmt: skip
_LINER = {"thickness_mm": 3.0, "youngs_modulus_kpa": 300.0}

# (table, key): the change, and the name under which a result records the value; None: it has no meaning
CHANGES: dict[tuple[str, str], tuple[Change, str | None]] = {
    ("subject", "id"): (_in("subject", id="S2"), "subject"),
    ("subject", "limb"): (_in("subject", limb="right"), "subject/limb"),
    ("files", "allow_outside"): (_instead("files", allow_outside=True), None),
    **{("imaging", key): (_instead("imaging", **table), "imaging") for key, table in {
        "mri": {"mri": "mri2"},
        "labels": {"mri": "mri", "labels": "labels.nii.gz"},
        "skin": _SURFACES,
        "bones": _SURFACES,
        "bodies": {"bodies": "skin.stl"},
        "unit": {**_SURFACES, "unit": "m"},
        "scale": {**_SURFACES, "scale": 2.0},
        "limb": {**_SURFACES, "limb": "right"},
        "bone": _SCAN,
        "bone_radius_mm": {**_SCAN, "bone_radius_mm": 13.0},
        "skin_scale_fraction": {**_SCAN, "skin_scale_fraction": 0.02},
        "shape": {"shape": _SHAPE},
        "fibres": {"mri": "mri", "fibres": "fibres.nii.gz"},
        "fibre_frame": {"mri": "mri", "fibres": "fibres.nii.gz", "fibre_frame": "lps"},
    }.items()},
    **{("socket", key): (_instead("socket", **{**beside, key: value}), "socket")
       for key, (value, beside) in _SOCKET.items()},
    **{("knee", key): (_instead("socket", knee={key: value}), "socket") for key, value in {
        "centre_mm": [0.0, 0.0, 40.0], "anterior_n": 10.0, "lateral_n": 10.0, "about_anterior_n_m": 2.0,
        "about_lateral_n_m": 2.0,
    }.items()},
    **{("liner", key): (_instead("socket", liner={**_LINER, key: value}), "socket") for key, value in {
        "thickness_mm": 4.0, "youngs_modulus_kpa": 400.0, "poisson": 0.4, "bonded": True,
    }.items()},
    ("liner", "friction"): (
        _instead("socket", liner={**_LINER, "bonded": False, "friction": 0.2}), "socket"
    ),
    ("probe", "name"): (_in("probe", name="another"), None),
    ("probe", "length_mm"): (_in("probe", length_mm=31.0), "probe"),
    ("probe", "width_mm"): (_in("probe", width_mm=13.0), "probe"),
    ("probe", "edge_radius_mm"): (_in("probe", edge_radius_mm=3.0), "probe"),
    ("model", "margin_mm"): (_in("model", margin_mm=25.0), "model/margin"),
    ("model", "element"): (_in("model", element="tet10"), "model/element"),
    ("site", "position_mm"): (_site(position_mm=[0.0, 29.0, 1.0]), "place"),
    ("site", "marker"): (_by_marker, "place"),
    ("site", "long_axis"): (_site(long_axis="axial"), "long_axis"),
    ("site", "levels"): (_site(levels="levels2.csv"), "levels"),
    ("site", "skin_bone_mm"): (_site(skin_bone_mm=22.0), "skin_bone"),
    ("site", "trace"): (_site(trace="trace2.csv"), "trace"),
    ("site", "swe_maps"): (_site(swe_maps="images"), "swe_maps"),
    ("site", "density_kg_per_m3"): (_site(density_kg_per_m3=1050.0), "density_kg_per_m3"),
    ("site", "fibre_direction"): (_site(fibre_direction=[0.0, 0.0, 1.0]), "fibres"),
    **{("pennation", key): (
        _site(pennation=[{"orientation": "axial", "pennation_deg": 15.0, "deviation_deg": 4.0}]), "fibres"
    ) for key in schema.PENNATION},
    **{("state", key): (_states(), "states") for key in schema.STATE},
    ("site", "unloaded_stretch_along"): (_states(unloaded_stretch_along=0.95), "states"),
    ("site", "unloaded_stretch_around"): (_states(unloaded_stretch_around=0.95), "states"),
    **{("noise", key): (_site(noise={"force_n": 0.1, key: value}), "noise") for key, value in {
        "force_n": 0.2, "depth_mm": 0.2, "swe_level_fraction": 0.1, "swe_pixel_fraction": 0.2,
        "layer_mm": 0.3, "source": "repeats",
    }.items()},
    **{("layer", key): (_site(layers={"fat": table}), "layers") for key, table in {
        "thickness_mm": {"thickness_mm": 5.0},
        **dict.fromkeys(("law", "c_kpa", "f_kappa", "m"), _OGDEN),
        "beta": {"thickness_mm": "mri", "law": "holmes_mow", "c_kpa": 2.0, "f_kappa": 40.0, "beta": 1.0},
    }.items()},
    **{(table, key): (
        _site(**{table: {**_INSTEAD.get(key, _NEEDED[table]), **_BESIDES.get(key, {}), key: value}}), table
    )
       for table, values in _VALUES.items() for key, value in values.items()},
}  # fmt: skip
# What is not a value: tables, whose keys are listed, and the name of a site, which names its results.
_TABLES = {("site", key) for key in ("name", "pennation", "state", "noise", "layers", *schema.INSTRUMENTS)}
SCHEMA = {
    "subject": schema.SUBJECT, "files": schema.FILES, "imaging": schema.IMAGING, "probe": schema.PROBE,
    "model": schema.MODEL, "site": schema.SITE, "noise": schema.NOISE, "layer": schema.LAYER,
    "socket": schema.SOCKET, "knee": schema.KNEE, "liner": schema.LINER,
    "pennation": schema.PENNATION, "state": schema.STATE, **schema.INSTRUMENTS,
}  # fmt: skip
EVERY_KEY = {(table, key) for table, keys in SCHEMA.items() for key in keys} - _TABLES
EVERY_KEY -= {("socket", "liner"), ("socket", "knee")}
