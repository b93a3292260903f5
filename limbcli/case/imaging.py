"""The table [imaging] of case.toml: images, surfaces, a scanned skin with bone from ultrasound, numbers."""

from __future__ import annotations

from collections.abc import Mapping
from math import nan, pi
from pathlib import Path
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.label_sources import read_label_sources
from limbcli.case.parts import SKIN_SCALE, Imaging, Shape
from limbcli.case.reading import CaseReading
from limbcli.case.schema import BONE_RADIUS_MM, Key, number
from limbcli.numbers.units import LENGTH_UNITS_IN_MM

SHAPE = {
    "circumference_mm": Key("mm", number(80.0, 1000.0, "mm"), required=True),
    "skin_mm": Key("mm", number(0.2, 10.0, "mm"), required=True),
    "fat_mm": Key("mm", number(0.0, 100.0, "mm"), required=True),
    "muscle_mm": Key("mm", number(0.0, 100.0, "mm"), required=True),
    "bone_radius_mm": Key("mm", number(3.0, 40.0, "mm"), default=BONE_RADIUS_MM),
}
_LEAST_DEPTH, _LEAST_BEHIND = 3.0, 2.0  # smallest thickness of tissue in front of the bone and behind it, mm
_FAULTY = Shape(nan, nan, nan, nan, nan)
_WAYS = ("mri", "labels", "skin", "bodies", "shape")


def read_imaging(parts: Mapping[str, Mapping[str, Any]], reading: CaseReading, *, present: bool) -> Imaging:
    """The sources of the geometry.

    parts : the tables [subject] and [imaging]; present : whether case.toml has the latter at all
    """
    table, limb = parts["imaging"], parts["subject"].get("limb")
    _contradictions(table, reading)
    if present and not any(table.get(key) for key in _WAYS):
        fix = 'add `mri = "folder or file"`, `labels = "file"`, `skin` and `bones`, `bodies`, or `shape`'
        reading.wrong("[imaging] specifies no geometry", fix)
    kinds = {"mri": None, "skin": False, "bodies": False, "fibres": False}
    paths = {
        key: reading.existing(table.get(key), f"imaging.{key}", is_folder=is_folder)
        for key, is_folder in kinds.items()
    }
    labels = read_label_sources(table.get("labels"), reading)
    mri = paths["mri"]
    if mri and mri.is_file() and not _is_image(mri):
        what = f"imaging.mri: {mri.name!r} is neither a folder nor a volume in a supported format"
        fix = (
            "give a folder with one DICOM series, a multi-frame DICOM file, or a file that ends in "
            f"{', '.join(schema.VOLUME_ENDINGS)}; unpack an archive; of PAR/REC, dcm2niix makes a NIfTI file"
        )
        reading.wrong(what, fix)
    bones = [
        reading.existing(name, f"imaging.bones[{k}]", is_folder=False)
        for k, name in enumerate(table.get("bones") or [])
    ]
    shape = None  # a faulty one still needs no position of its sites
    if table.get("shape") is not None:
        shape = read_shape(table["shape"], reading) or _FAULTY
    radius = float(table.get("bone_radius_mm") or BONE_RADIUS_MM) if table.get("bone") else None
    fibres, frame = paths["fibres"], table.get("fibre_frame")
    if fibres is not None and not fibres.name.lower().endswith((".nii", ".nii.gz")):
        what = f"imaging.fibres: {fibres.name!r} is not a NIfTI file"
        reading.wrong(what, "save the principal directions as .nii or .nii.gz")
    stated = table.get("skin_scale_fraction")
    scale = SKIN_SCALE if stated is None else float(stated)
    unit, mm_per_unit = table.get("unit") or "", table.get("scale")
    if unit:
        mm_per_unit = LENGTH_UNITS_IN_MM[unit]
    mirrored = table.get("limb") is not None and limb is not None and table["limb"] != limb
    length = None if mm_per_unit is None else float(mm_per_unit)
    return Imaging(
        mri=mri, labels=labels, skin=paths["skin"] or paths["bodies"],
        bones=tuple(each for each in bones if each), bone_radius=radius, shape=shape, fibres=fibres,
        fibre_frame=frame, skin_scale=scale, mm_per_unit=length, unit=unit, mirrored=mirrored,
    )  # fmt: skip


def _is_image(path: Path) -> bool:
    """Whether a file may be a volume: by its name, or as DICOM."""
    if path.name.lower().endswith(schema.VOLUME_ENDINGS):
        return True
    from limbcli.files.dicom import has_preamble

    return has_preamble(path)


def _contradictions(table: Mapping[str, Any], reading: CaseReading) -> None:
    if table.get("bones") and not table.get("skin"):
        reading.wrong("[imaging] has bones but no skin", 'add `skin = "file"`')
    if table.get("mri") and table.get("skin"):
        reading.wrong("[imaging] has both `mri` and `skin`", "keep one of the two")
    if table.get("bone") and not table.get("skin"):
        fix = 'add `skin = "scan.stl"`, or give the whole limb in numbers: `shape = { ... }`'
        reading.wrong("[imaging] has a bone from ultrasound but no skin", fix)
    if table.get("bone_radius_mm") and not table.get("bone"):
        fix = (
            'add `bone = "from-ultrasound"`, or remove it; for a limb given in numbers, it belongs in `shape`'
        )
        reading.wrong("[imaging] has bone_radius_mm but no `bone` it refers to", fix)
    if table.get("skin_scale_fraction") is not None and not table.get("bone"):
        what = "[imaging] has skin_scale_fraction, which applies only with a bone from ultrasound"
        fix = 'add `bone = "from-ultrasound"`, or remove it'
        reading.wrong(what, fix)
    if table.get("bone") and table.get("bones"):
        what = "[imaging] has both `bones` and a bone from ultrasound"
        reading.wrong(what, "keep `bones` where they were imaged, else `bone`")
    if table.get("unit") and table.get("scale") is not None:
        reading.wrong("[imaging] has both `unit` and `scale`", "keep one of the two")
    for key in ("unit", "scale", "limb"):
        if table.get(key) is not None and not (table.get("skin") or table.get("bodies")):
            what = f"[imaging] has `{key}`, which applies to surfaces only"
            reading.wrong(what, "remove it, or give the surfaces: `skin` and `bones`, or `bodies`")
    rivals = [key for key in ("mri", "labels", "skin", "bones", "bone") if table.get(key)]
    if table.get("bodies") and rivals:
        what = f"[imaging] has both `bodies` and `{rivals[0]}`"
        reading.wrong(what, "keep `bodies` where one file holds the skin and all bones")
    others = [key for key in ("mri", "labels", "skin", "bodies", "bones", "bone") if table.get(key)]
    if table.get("shape") is not None and others:
        what = f"[imaging] has both `shape` and `{others[0]}`"
        reading.wrong(what, "keep what was imaged; `shape` is only for a limb given in numbers")


def read_shape(raw: object, reading: CaseReading) -> Shape | None:
    """A limb given by numbers; None, with problems, if no limb can have them.

    >>> from pathlib import Path
    >>> whole = {"circumference_mm": 300, "skin_mm": 1.5, "fat_mm": 6, "muscle_mm": 20}
    >>> reading = CaseReading(Path())
    >>> read_shape(whole, reading).bone_radius, read_shape({**whole, "circumference_mm": 120}, reading)
    (14.0, None)
    >>> print(reading.problems[0].what)
    a limb of 120 mm circumference is 38.2 mm across: less than its layers (27.5 mm) and the bone (28 mm)
    """
    name = "imaging.shape"
    if isinstance(raw, dict) and "skin_mm" not in raw and {"fat_mm", "muscle_mm"} & set(raw):
        given = " and ".join(key for key in ("fat_mm", "muscle_mm") if key in raw)
        what = f"[{name}] has layers without skin: {given}, but no skin_mm"
        fix = "add skin_mm (1 to 2 mm if it was not measured separately: subtract it from fat_mm)"
        reading.wrong(what, fix)
        return None
    own = reading.part()
    values = own.table(raw, SHAPE, name)
    if own.problems:
        return None
    shape = Shape(*(float(values[key]) for key in SHAPE))
    across, needed = shape.circumference / pi, shape.skin_bone + 2 * shape.bone_radius
    if needed + _LEAST_BEHIND > across:
        what = (
            f"a limb of {shape.circumference:g} mm circumference is {across:.1f} mm across: less than its "
            f"layers ({shape.skin_bone:g} mm) and the bone ({2 * shape.bone_radius:g} mm)"
        )
        fix = "circumference_mm is measured with a tape round the limb; layers, bone_radius_mm are also in mm"
        own.wrong(what, fix)
    if shape.skin_bone < _LEAST_DEPTH:
        what = f"the layers of [{name}] leave {shape.skin_bone:g} mm from skin to bone"
        fix = f"at least {_LEAST_DEPTH:g} mm can be modelled; muscle_mm extends to the bone"
        own.wrong(what, fix)
    return None if own.problems else shape


def check_place(
    values: Mapping[str, Any], given: list[str], imaging: Imaging, label: str, reading: CaseReading
) -> None:
    """Check how a site's position is given; a limb given by numbers needs none."""
    if imaging.shape is not None and not given:
        return
    if imaging.assumed and "marker" in given:
        what = (
            f"{label} is given by marker {values.get('marker')}, and there are no images that could show one"
        )
        fix = "remove position_mm and marker: the site is anterior" if imaging.shape else "give position_mm"
        reading.wrong(what, fix)
    elif len(given) != 1:
        what = "has neither position_mm nor marker" if not given else "has both position_mm and marker"
        reading.wrong(f"{label} {what}", "give exactly one of the two")
