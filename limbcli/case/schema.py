"""The schema of case.toml: every key with its type, default and plausible range.

`check_table` checks one table and reports every problem; nothing here accesses files.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any
from weakref import WeakKeyDictionary

from limbcli.errors.problems import Problem, suggestion
from limbcli.numbers.mesh_bounds import LIMB_NODES, MARGIN_MM
from limbcli.numbers.units import FORCE_UNITS_IN_N, LENGTH_UNITS_IN_MM, TIME_UNITS_IN_S

FILL_IN = "FILL IN"  # placeholder that `limbcli new` writes for a value the user must give
# Longest name of a site, bytes: file systems allow 255, and names of results contain more than the site's.
_LONGEST_NAME = 100
FAILED = "-failed"  # suffix, after the site's name, of the folder of a failed run
Check = Callable[[Any], str | None]
"""Returns what is wrong with a value, or None."""
JSON: WeakKeyDictionary[Check, dict[str, Any]] = WeakKeyDictionary()
"""The same as a JSON Schema, for editors; a check that is not listed takes anything."""


def _told(json: dict[str, Any]) -> Callable[[Check], Check]:
    """Decorator: list a check with its JSON Schema."""

    def keep(check: Check) -> Check:
        JSON[check] = json
        return check

    return keep


_TEXT = {"type": "string", "pattern": r"\S"}


def _numbers(count: int) -> dict[str, Any]:
    return {"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count}


def _or_list(one: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}


@dataclass(frozen=True)
class Key:
    """One key: a description of its type, its check, and whether it is required."""

    kind: str
    check: Check
    required: bool = False
    default: Any = None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def number(low: float, high: float, unit: str) -> Check:
    """A number within plausible limits."""

    @_told({"type": "number", "minimum": low, "maximum": high})
    def check(value: object) -> str | None:
        if not _is_number(value):
            return f"is {value!r}, not a number"
        if not low <= value <= high:  # type: ignore[operator]
            in_unit = f" {unit}" if unit else ""
            return f"is {value:g}{in_unit}; plausible values are {low:g} to {high:g}{in_unit}"
        return None

    return check


@_told({"const": 1})
def format_one(value: object) -> str | None:
    """
    >>> format_one(1), format_one(True)
    (None, 'is True; this program reads format 1')
    """
    good = isinstance(value, int) and not isinstance(value, bool) and value == 1
    return None if good else f"is {value!r}; this program reads format 1"


@_told(_TEXT)
def text(value: object) -> str | None:
    return None if isinstance(value, str) and value.strip() else f"is {value!r}, not text"


@_told({"type": "string", "minLength": 1, "maxLength": 1})
def one_mark(value: object) -> str | None:
    """A column separator: one character, neither a quotation mark nor a line end."""
    good = isinstance(value, str) and len(value) == 1 and value not in '"\r\n'
    return None if good else f'is {value!r}, not a single character such as ";", "," or "\\t"'


@_told({"type": "string", "pattern": r"^[\w-][\w.-]*$"})
def plain_name(value: object) -> str | None:
    """A name that is also valid as a folder name."""
    wrong = text(value)
    if wrong is None and not all(letter.isalnum() or letter in "-_." for letter in str(value)):
        wrong = f"is {value!r}; use letters, digits, '-', '_' and '.' only"
    if wrong is None and str(value).startswith("."):
        wrong = f"is {value!r}; it must not begin with '.'"
    if wrong is None and len(str(value).encode()) > _LONGEST_NAME:
        wrong = f"is {len(str(value))} letters long ({str(value)[:12]}...); give a short name, such as p1"
    return wrong


def folder_key(name: str) -> str:
    """The same for names that some file system takes for one: by case, Unicode form, or dots at the end.

    >>> folder_key("P1") == folder_key("p1."), folder_key("Caf\u00e9") == folder_key("cafe\u0301")
    (True, True)
    """
    return unicodedata.normalize("NFC", name).casefold().rstrip(".")


@_told({"type": "string", "pattern": r"^[\w-][\w.-]*$"})
def site_name(value: object) -> str | None:
    """
    >>> site_name("p1"), site_name("p1-failed")
    (None, "is 'p1-failed'; that name is reserved for the failure record of site 'p1'")
    """
    wrong, (site, ending, rest) = plain_name(value), str(value).rpartition(FAILED)
    if wrong is None and ending and not rest:
        wrong = f"is {value!r}; that name is reserved for the failure record of site {site!r}"
    return wrong


def one_of(*choices: str) -> Check:
    @_told({"enum": list(choices)})
    def check(value: object) -> str | None:
        if value in choices:
            return None
        hint = suggestion(str(value), choices)
        return f"is {value!r}; one of {', '.join(map(repr, choices))} ({hint})"

    return check


@_told({"type": "array", "items": _TEXT, "minItems": 1})
def texts(value: object) -> str | None:
    good = isinstance(value, list) and value and all(text(each) is None for each in value)
    return None if good else f"is {value!r}, not a list of strings"


def label_sources(value: object) -> str | None:
    """A file or folder of labels, a table that names it, or a list of these.

    >>> label_sources("a.nii"), label_sources([{"file": "a.nii", "preset": "x", "8": "bone"}])
    (None, None)
    >>> label_sources({"8": "bone"}), label_sources({"file": "a.nii", "8": 2})
    ('lacks `file`, the label map (a file or folder)', 'has 8 = 2, which is not text')
    """
    if isinstance(value, list):
        wrong = [label_sources(each) for each in value if not isinstance(each, list)]
        return next((each for each in wrong if each), None) if value and wrong else f"is {value!r}"
    if not isinstance(value, dict):
        return text(value)
    if "file" not in value:
        return "lacks `file`, the label map (a file or folder)"
    wrong_key = next((key for key, each in value.items() if text(each) is not None), None)
    return f"has {wrong_key} = {value[wrong_key]!r}, which is not text" if wrong_key is not None else None


@_told(_numbers(3))
def vector(value: object) -> str | None:
    good = isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))
    return None if good else f"is {value!r}, not three numbers [x, y, z]"


@_told({"anyOf": [{"enum": ["transverse", "axial"]}, _numbers(3)]})
def axis(value: object) -> str | None:
    if isinstance(value, str):
        return one_of("transverse", "axial")(value)
    wrong = vector(value)
    if wrong is None and not any(value):  # type: ignore[arg-type]
        wrong = "has length zero"
    return wrong


@_told(_numbers(3))
def direction(value: object) -> str | None:
    """A vector of non-zero length.

    >>> direction([0, 0, 0]), direction([0, 0, 1])
    ('has zero length and therefore no direction', None)
    """
    wrong = vector(value)
    if wrong is None and not any(value):  # type: ignore[arg-type]
        wrong = "has zero length and therefore no direction"
    return wrong


def tables(value: object) -> str | None:
    good = isinstance(value, list) and value and all(isinstance(each, dict) for each in value)
    return None if good else f"is {value!r}, not a list of tables"


def whole(low: int, high: int) -> Check:
    @_told({"type": "integer", "minimum": low, "maximum": high})
    def check(value: object) -> str | None:
        good = isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
        return None if good else f"is {value!r}, not a whole number from {low} to {high}"

    return check


@_told({"type": "boolean"})
def truth(value: object) -> str | None:
    return None if isinstance(value, bool) else f"is {value!r}, neither true nor false"


def table(value: object) -> str | None:
    return None if isinstance(value, dict) else f"is {value!r}, not a table"


@_told({"type": "object", "additionalProperties": _TEXT})
def table_of_texts(value: object) -> str | None:
    good = isinstance(value, dict) and all(text(each) is None for each in value.values())
    return None if good else f"is {value!r}, not a table of strings"


def numbers(count: int) -> Check:
    @_told(_numbers(count))
    def check(value: object) -> str | None:
        good = isinstance(value, list) and len(value) == count and all(map(_is_number, value))
        return None if good else f"is {value!r}, not a list of {count} numbers"

    return check


def lengths(low: float, high: float) -> Check:
    """A length in mm (at level 0), or one for every level."""
    one = number(low, high, "mm")

    @_told(_or_list(JSON[one]))
    def check(value: object) -> str | None:
        if isinstance(value, list) and value:
            return next((wrong for each in value if (wrong := one(each))), None)
        return one(value)

    return check


@_told(_or_list({"type": "integer", "minimum": 1, "maximum": 100_000}))
def frames(value: object) -> str | None:
    """The number of a frame in a multi-frame file, from 1, or one for every level."""
    one = whole(1, 100_000)
    if isinstance(value, list) and value:
        return next((wrong for each in value if (wrong := one(each))), None)
    return one(value)


@_told({"anyOf": [{"const": "mri"}, {"type": "number", "minimum": 0.2, "maximum": 40.0}]})
def thickness(value: object) -> str | None:
    """A thickness in mm, or "mri" to take it from the images."""
    return None if value == "mri" else number(0.2, 40.0, "mm")(value)


@_told({"type": "array", "minItems": 1, "items": {"type": "number", "minimum": 0.1, "maximum": 5000.0}})
def loads(value: object) -> str | None:
    """Forces in N, each above 0.

    >>> loads([400, 800]), loads([400, -1])
    (None, 'has -1 N; plausible values are 0.1 to 5000 N')
    """
    if not isinstance(value, list) or not value:
        return f"is {value!r}, not a list of forces in N"
    wrong = next((each for each in map(number(0.1, 5000.0, "N"), value) if each), None)
    return None if wrong is None else wrong.replace("is ", "has ", 1)


# Default radius of the bone. The tibia's section in OpenLimb's mean residual limb has the area of a circle of
# 12 to 19 mm radius, 3 to 9 cm above the end (Sunderland et al. 2024, doi 10.1101/2024.11.27.24317622); in
# others of that set 9 to 20.
BONE_RADIUS_MM = 14.0
# Permitted stretch ratios. Sarcomeres bear force at 0.6 to 1.7 of their optimal length (Gordon et al. 1966, J
# Physiol 184:170).
STRETCHES = (0.5, 2.0)


@_told(JSON[number(*STRETCHES, "")])
def known_stretch(value: object) -> str | None:
    """A ratio of lengths.

    >>> known_stretch(90)
    'is 90; plausible values are 0.5 to 2 (a ratio of lengths, not a percentage or a strain)'
    """
    wrong = number(*STRETCHES, "")(value)
    told = wrong and _is_number(value)
    return f"{wrong} (a ratio of lengths, not a percentage or a strain)" if told else wrong


@_told({"anyOf": [{"const": "unknown"}, JSON[known_stretch]]})
def stretch(value: object) -> str | None:
    """A ratio of lengths, or "unknown"."""
    return None if value == "unknown" else known_stretch(value)


# of a volume, or of the header whose values lie beside it
VOLUME_ENDINGS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".hdr", ".mgh", ".mgz")

SUBJECT = {
    "id": Key("text", plain_name, required=True),
    "limb": Key("left | right", one_of("left", "right"), required=True),
}
IMAGING = {
    "mri": Key("folder of DICOM files, or a multi-frame DICOM, NIfTI, NRRD, MetaImage or MGH file", text),
    "labels": Key("file or folder, or a table with it, or a list of such tables", label_sources),
    "skin": Key("file", text),
    "bones": Key("list of files", texts),
    "bodies": Key("file that holds the skin and all bones", text),
    "unit": Key(
        "unit of length of the surfaces", one_of(*LENGTH_UNITS_IN_MM)
    ),  # none: as they state it, else mm
    "scale": Key("mm per length 1 in the surfaces", number(1e-6, 1e6, "")),  # instead of `unit`
    "limb": Key("left | right", one_of("left", "right")),  # that the surfaces show; none: the subject's
    "bone": Key("from-ultrasound", one_of("from-ultrasound")),
    "bone_radius_mm": Key("mm", number(3.0, 40.0, "mm")),  # with `bone`; none: BONE_RADIUS_MM
    "skin_scale_fraction": Key("1", number(0.0, 0.3, "")),  # with `bone`; none: SKIN_SCALE
    "shape": Key("table", table),
    "fibres": Key("NIfTI file of 3 components", text),
    "fibre_frame": Key("ras | lps | fsl", one_of("ras", "lps", "fsl")),  # none: ras
}
FILES = {"allow_outside": Key("true | false", truth, default=False)}
PROBE = {
    "name": Key("text", text, default="probe"),
    "length_mm": Key("mm", number(5.0, 150.0, "mm"), required=True),
    "width_mm": Key("mm", number(3.0, 60.0, "mm"), required=True),
    "edge_radius_mm": Key("mm", number(0.0, 20.0, "mm"), default=3.0),
}
MODEL = {
    "margin_mm": Key("mm", number(*MARGIN_MM, "mm"), default=40.0),
    "element": Key("tet10 | tet4", one_of("tet10", "tet4"), default="tet10"),
}
SITE = {
    "name": Key("text", site_name, required=True),
    "position_mm": Key("[x, y, z]", vector),
    "marker": Key("number", whole(1, 99)),
    "long_axis": Key("transverse | axial | [x, y, z]", axis, required=True),
    "levels": Key("file", text, required=True),
    "skin_bone_mm": Key("mm", number(2.0, 120.0, "mm")),
    "trace": Key("file", text),
    "swe_maps": Key("folder", text),
    "density_kg_per_m3": Key("kg/m3", number(800.0, 1300.0, "kg/m3"), default=1000.0),
    "fibre_direction": Key("[x, y, z]", direction),
    "pennation": Key("list of tables", tables),
    "state": Key("list of tables", tables),
    "unloaded_stretch_along": Key("1", known_stretch),
    "unloaded_stretch_around": Key("1", known_stretch),
    "noise": Key("table", table),
    "layers": Key("table", table),
    "load_cell": Key("table", table),
    "b_mode": Key("table", table),
    "swe_images": Key("table", table),
}
LOAD_CELL = {
    "file": Key("file", text, required=True),
    "columns": Key("table of texts", table_of_texts, default={}),
    "time_unit": Key("unit", one_of(*TIME_UNITS_IN_S)),  # none: as the file states it, else s
    "force_unit": Key("unit", one_of(*FORCE_UNITS_IN_N)),  # none: ... N
    "length_unit": Key("unit", one_of(*LENGTH_UNITS_IN_MM)),  # none: ... mm
    "separator": Key("one mark", one_mark),
    "decimal": Key(". | ,", one_of(".", ",")),
    "hold_s": Key("s", number(0.5, 600.0, "s"), default=5.0),
    "hold_tolerance_n": Key("N", number(0.005, 5.0, "N"), default=0.1),
    "step_n": Key("N", number(0.1, 50.0, "N"), default=2.0),
    "tare_s": Key("[from, to] s", numbers(2)),
    "probe_mass_kg": Key("kg", number(0.0, 5.0, "kg"), default=0.0),
    "axis": Key("x | y | z | -x | -y | -z", one_of("x", "y", "z", "-x", "-y", "-z"), default="z"),
}
B_MODE = {
    "folder": Key("folder", text, required=True),
    "mm_per_pixel": Key("mm", number(0.005, 1.0, "mm")),
    "frame": Key("number from 1, or a list of them", frames),
    "box_pixels": Key("[left, top, right, bottom]", numbers(4)),
    "bone_mm": Key("mm, or a list of them", lengths(2.0, 120.0)),
    "skin_mm": Key("mm, or a list of them", lengths(0.2, 60.0)),
    "fat_mm": Key("mm, or a list of them", lengths(0.2, 60.0)),
}
SWE_IMAGES = {
    "folder": Key("folder", text, required=True),
    "mm_per_pixel": Key("mm", number(0.005, 1.0, "mm")),
    "frame": Key("number from 1, or a list of them", frames),
    "image_pixels": Key("[left, top, right, bottom]", numbers(4)),
    "box_pixels": Key("[left, top, right, bottom]", numbers(4)),
    "bar_pixels": Key("[left, top, right, bottom]", numbers(4)),
    "low_m_per_s": Key("m/s", number(0.0, 20.0, "m/s"), default=0.0),
    "high_m_per_s": Key("m/s", number(0.5, 30.0, "m/s")),
    "low_kpa": Key("kPa", number(0.0, 1200.0, "kPa"), default=0.0),
    "high_kpa": Key("kPa", number(0.75, 2700.0, "kPa")),
    "preset": Key("mach30", one_of("mach30")),
    "bar_scale": Key("speed | modulus", one_of("speed", "modulus"), default="speed"),
    "opacity": Key("1", number(0.2, 1.0, ""), default=1.0),
    "roi_depth_mm": Key("[from, to] mm", numbers(2)),
    "roi_lateral_mm": Key("[from, to] mm", numbers(2)),
}
INSTRUMENTS = {"load_cell": LOAD_CELL, "b_mode": B_MODE, "swe_images": SWE_IMAGES}
LAYER_NAMES = ("skin", "fat")
LAYER = {
    "thickness_mm": Key('mm | "mri"', thickness, required=True),
    "law": Key("ogden | neo_hooke | holmes_mow", one_of("ogden", "neo_hooke", "holmes_mow")),
    "c_kpa": Key("kPa", number(0.01, 1e4, "kPa")),
    "f_kappa": Key("1", number(0.01, 1000.0, "")),
    "m": Key("1", number(1.0, 100.0, "")),
    "beta": Key("1", number(0.0, 50.0, "")),
}
PENNATION = {
    "orientation": Key("axial | transverse | a site's name", text, required=True),
    "pennation_deg": Key("deg", number(-89.0, 89.0, "deg"), required=True),
    "deviation_deg": Key("deg", number(0.1, 45.0, "deg"), default=5.0),
}
STATE = {
    "name": Key("text", plain_name, required=True),
    "stretch_along": Key('1 | "unknown"', stretch),
    "stretch_around": Key('1 | "unknown"', stretch),
    "levels": Key("file", text, required=True),
}
NOISE = {
    "force_n": Key("N", number(0.0, 5.0, "N"), default=0.1),
    "depth_mm": Key("mm", number(0.0, 5.0, "mm"), default=0.3),
    "swe_level_fraction": Key("1", number(0.0, 0.5, ""), default=0.05),
    "swe_pixel_fraction": Key("1", number(0.0, 1.0, ""), default=0.10),
    "layer_mm": Key("mm", number(0.0, 5.0, "mm"), default=0.2),
    "source": Key("repeats | spec | assumed", one_of("repeats", "spec", "assumed"), default="assumed"),
}
SOCKET = {
    "surface": Key("file", text),
    "align": Key("true | false", truth, default=False),
    "landmarks": Key("table of [x, y, z]", table),
    "rectifications_mm": Key("table of mm", table),
    "all_mm": Key("mm", number(-20.0, 20.0, "mm")),
    "transition_mm": Key("mm", number(1.0, 60.0, "mm")),
    "brim_mm": Key("mm", number(20.0, 1000.0, "mm")),
    "flare_mm": Key("mm", number(0.0, 15.0, "mm")),
    "liner": Key("table", table),
    "friction": Key("1", number(0.0, 2.0, ""), default=0.3),
    "friction_deviation": Key("1", number(0.0, 0.5, ""), default=0.1),
    "loads_n": Key("list of N", loads, default=[400.0, 800.0]),
    "tilt_deviation_deg": Key("deg", number(0.0, 10.0, "deg"), default=1.0),
    "shift_deviation_mm": Key("mm", number(0.0, 20.0, "mm"), default=1.0),
    "knee": Key("table", table),
    "limb_nodes": Key("number", whole(*LIMB_NODES), default=40_000),
}
KNEE = {
    "centre_mm": Key("[x, y, z] mm", vector),
    "anterior_n": Key("N", number(-2000.0, 2000.0, "N"), default=0.0),
    "lateral_n": Key("N", number(-2000.0, 2000.0, "N"), default=0.0),
    "about_anterior_n_m": Key("N m", number(-200.0, 200.0, "N m"), default=0.0),
    "about_lateral_n_m": Key("N m", number(-200.0, 200.0, "N m"), default=0.0),
}
LINER = {
    "thickness_mm": Key("mm", number(0.5, 20.0, "mm"), required=True),
    "youngs_modulus_kpa": Key("kPa", number(5.0, 100_000.0, "kPa"), required=True),
    "poisson": Key("1", number(0.0, 0.495, ""), default=0.45),
    "bonded": Key("true | false", truth, default=True),
    "friction": Key("1", number(0.0, 2.0, "")),
}
TOP = {
    "format": Key("1", format_one),
    **dict.fromkeys(("subject", "files", "imaging", "probe", "model"), Key("table", lambda _: None)),
    "site": Key("list of tables", lambda _: None),
    "socket": Key("table", lambda _: None),
}
# words of the field that are not similar to the key of what they mean
OTHER_WORDS = {
    "side": "limb", "leg": "limb", "laterality": "limb", "patient": "id", "dicom": "mri", "image": "mri",
    "images": "mri", "series": "mri", "ct": "mri", "segmentation": "labels", "mask": "labels",
    "surface": "skin", "location": "position_mm", "coordinates": "position_mm", "orientation": "long_axis",
    "pixel_spacing": "mm_per_pixel",
}  # fmt: skip


def check_table(
    table: object, schema: Mapping[str, Key], *, name: str, file: str
) -> tuple[dict[str, Any], list[Problem]]:
    """Values with defaults filled in, and every problem of one table.

    >>> _, problems = check_table({"lenght_mm": 53}, PROBE, name="probe", file="case.toml")
    >>> for each in problems: print(each.what)
    unknown key 'lenght_mm' in [probe]
    [probe] is missing 'length_mm' (mm)
    [probe] is missing 'width_mm' (mm)
    """
    if not isinstance(table, dict):
        problem = Problem(f"[{name}] is not a table", file, f"write it as [{name}] with `key = value` lines")
        return {}, [problem]
    problems = [
        Problem(f"unknown key {key!r} in [{name}]", file, suggestion(key, schema, OTHER_WORDS))
        for key in table
        if key not in schema
    ]
    values: dict[str, Any] = {}
    for key, rule in schema.items():
        if key not in table:
            values[key] = rule.default
            if rule.required:
                problems.append(
                    Problem(
                        f"[{name}] is missing {key!r} ({rule.kind})", file, f"add `{key} = ...` to [{name}]"
                    )
                )
            continue
        values[key] = table[key]
        if table[key] == FILL_IN:
            values[key] = rule.default
            problems.append(_unfilled(name, key, rule, file))
        elif wrong := rule.check(table[key]):
            problems.append(
                Problem(f"{name}.{key} {wrong}", file, f"correct {key} ({rule.kind}) in [{name}]")
            )
            values[key] = rule.default
    return values, problems


def _unfilled(name: str, key: str, rule: Key, file: str) -> Problem:
    """
    >>> print(_unfilled("probe", "width_mm", PROBE["width_mm"], "case.toml").fix)
    write `width_mm = ...`: mm, without the quotes
    """
    is_text = rule.check("text") is None or "|" in rule.kind
    fix = (
        f'write `{key} = "..."`: {rule.kind}'
        if is_text
        else f"write `{key} = ...`: {rule.kind}, without the quotes"
    )
    return Problem(f"{name}.{key} is still to be filled in", file, fix)
