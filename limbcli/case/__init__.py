"""The case folder, format 1: the user's input.

`Case.open(folder)` reads and checks `case.toml`, checks that the files it names exist, and raises one error
with every problem. The contents of the files are checked by the packages that read them; `limbcli check` runs
all of these checks at once.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import nan
from pathlib import Path
from typing import Any, Literal

from limbcli.case import schema as schema
from limbcli.case.imaging import check_place, read_imaging
from limbcli.case.instruments import read_instruments, read_layers
from limbcli.case.parts import Imaging, ModelOptions, Probe, Site, StatedNoise, point
from limbcli.case.reading import CaseReading
from limbcli.case.socket import read_socket
from limbcli.case.stated_fibres import check_fibres, read_fibres
from limbcli.case.states import read_states, site_schema
from limbcli.case.toml_file import read_toml, toml_fix
from limbcli.config import at_home
from limbcli.errors import CaseError
from limbcli.errors.file_system import not_in_utf8
from limbcli.errors.problems import Problem, checked, errors_of

__all__ = ["CASE_FILE", "Case", "Imaging", "ModelOptions", "Probe", "Site", "StatedNoise", "read_case"]

CASE_FILE = "case.toml"
_NO_PROBE = {"name": "", "length_mm": nan, "width_mm": nan, "edge_radius_mm": nan}


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """One subject's folder, read and checked."""

    folder: Path
    subject: str
    limb: Literal["left", "right"]
    imaging: Imaging
    probe: Probe
    model: ModelOptions
    sites: tuple[Site, ...]
    raw: Mapping[str, Any]

    def __repr__(self) -> str:
        names = ", ".join(site.name for site in self.sites)
        return (
            f"Case({str(self.folder)!r}: subject {self.subject}, {self.limb} limb, sites {names or 'none'})"
        )

    def _repr_html_(self) -> str:
        """Notebook representation: the subject, and a row for each site."""
        rows = "".join(
            f"<tr><td>{escape(each.name)}</td><td>{escape(_place(each))}</td>"
            f"<td>{escape(str(each.long_axis))}</td><td>{escape(each.levels.name)}</td></tr>"
            for each in self.sites
        )
        probe = f"{self.probe.name}, {self.probe.length:g} x {self.probe.width:g} mm"
        return (
            f"<div><b>{escape(self.subject)}</b>, {self.limb} limb: {escape(str(self.folder))}<div>probe: "
            f"{escape(probe)}</div><table><tr><th>site</th><th>place (patient LPS, mm)</th><th>long "
            f"axis</th><th>levels</th></tr>{rows}</table></div>"
        )

    @property
    def file(self) -> Path:
        """case.toml itself."""
        return self.folder / CASE_FILE

    @staticmethod
    def open(folder: Path | str) -> Case:
        """Read and check a case folder.

        Raises
        ------
        CaseError
            With every problem of case.toml and every missing file.
        """
        return checked(*read_case(at_home(Path(folder))), CaseError)

    @staticmethod
    def open_images(folder: Path) -> Case:
        """Read a case of which only the images are needed; probe, sites and measurements may be missing.

        Only complete sites are included; if the probe is incomplete, all its dimensions are NaN.

        Raises
        ------
        CaseError
            With every problem of [subject] and [imaging].
        """
        case, _ = read_case(folder)
        if case is not None:
            return case
        raw, unread = _read_toml(folder)
        if raw is None:
            return checked(None, unread, CaseError)
        return checked(*_read_images(raw, folder), CaseError)

    @staticmethod
    def open_limb(folder: Path) -> Case:
        """Read a case that may have no sites: then only the images are needed, as by `open_images`.

        Raises
        ------
        CaseError
            As `open`, or as `open_images` where case.toml has no site.
        """
        raw, _ = _read_toml(folder)
        return Case.open_images(folder) if raw is not None and "site" not in raw else Case.open(folder)

    def site(self, name: str) -> Site:
        """One site by name.

        Raises
        ------
        CaseError
            If there is none of that name.
        """
        for each in self.sites:
            if each.name == name:
                return each
        names = ", ".join(each.name for each in self.sites)
        raise CaseError(f"there is no site {name!r}", where=str(self.file), fix=f"the sites are: {names}")

    def selected(self, names: list[str] | None) -> tuple[Site, ...]:
        """The named sites, each once, or all sites."""
        return tuple(self.site(name) for name in dict.fromkeys(names)) if names else self.sites


def _place(site: Site) -> str:
    return f"marker {site.marker}" if site.position is None else ", ".join(f"{x:.1f}" for x in site.position)


def read_case(folder: Path, *, limb_alone: bool = False) -> tuple[Case | None, list[Problem]]:
    """The case (None if there are errors), and every problem found.

    limb_alone : a case with a socket and without sites needs no probe either
    """
    raw, problems = _read_toml(folder)
    if raw is None:
        return None, problems
    limb_alone &= "socket" in raw and "site" not in raw
    reading = CaseReading.of(raw, folder)
    reading.table(raw, schema.TOP, "case.toml")
    _check_format(raw, reading)
    tables = {
        "subject": schema.SUBJECT, "imaging": schema.IMAGING, "probe": schema.PROBE, "model": schema.MODEL,
        "files": schema.FILES,
    }  # fmt: skip
    parts = _read_tables(raw, tables, reading, optional=("probe",) if limb_alone else ())
    imaging = read_imaging(parts, reading, present="imaging" in raw)
    sites = [] if limb_alone else _read_sites(raw.get("site"), reading, imaging)
    read_socket(raw, reading)
    if limb_alone and "probe" not in raw:
        parts["probe"] = _NO_PROBE
    found = reading.problems
    return None if errors_of(found) else _assemble(folder, raw, parts, imaging, sites), found


def _check_format(raw: Mapping[str, Any], reading: CaseReading) -> None:
    if "format" not in raw:
        reading.wrong("case.toml is missing 'format'", "add `format = 1` as its first line")


def _read_tables(
    raw: Mapping[str, Any],
    tables: Mapping[str, Mapping[str, schema.Key]],
    reading: CaseReading,
    optional: Sequence[str] = (),
) -> dict[str, dict[str, Any]]:
    """Values by table; a missing table that is neither optional nor always so is a problem."""
    parts: dict[str, dict[str, Any]] = {}
    for name, keys in tables.items():
        if name in raw:
            parts[name] = reading.table(raw[name], keys, name)
            continue
        if name not in ("model", "files", *optional):
            reading.wrong(f"case.toml has no table [{name}]", f"add [{name}]")
        parts[name] = schema.check_table({}, keys, name=name, file=reading.file)[0]
    return parts


def _assemble(
    folder: Path,
    raw: Mapping[str, Any],
    parts: Mapping[str, Mapping[str, Any]],
    imaging: Imaging,
    sites: list[Site],
) -> Case:
    probe, model = parts["probe"], parts["model"]
    sides = (float(probe[f"{name}_mm"]) for name in ("length", "width", "edge_radius"))
    return Case(
        folder=folder,
        subject=parts["subject"]["id"],
        limb=parts["subject"]["limb"],
        imaging=imaging,
        probe=Probe(probe["name"], *sides),
        model=ModelOptions(margin=float(model["margin_mm"]), element=model["element"]),
        sites=tuple(sites),
        raw=raw,
    )


def _read_images(raw: Mapping[str, Any], folder: Path) -> tuple[Case | None, list[Problem]]:
    """The case without faulty probe and sites; and every problem of what this reading requires."""
    reading = CaseReading.of(raw, folder)
    reading.table({key: value for key, value in raw.items() if key == "format"}, schema.TOP, "case.toml")
    _check_format(raw, reading)
    parts = _read_tables(raw, {"subject": schema.SUBJECT, "imaging": schema.IMAGING}, reading)
    imaging = read_imaging(parts, reading, present="imaging" in raw)
    if errors_of(reading.problems):
        return None, reading.problems
    others = CaseReading.of(raw, folder)  # its problems are not of this reading
    sizes = others.table(raw.get("probe", {}), schema.PROBE, "probe")
    if others.problems:
        sizes = _NO_PROBE
    parts |= {"probe": sizes, "model": others.table(raw.get("model", {}), schema.MODEL, "model")}
    return _assemble(folder, raw, parts, imaging, _read_sites(raw.get("site"), others, imaging)), []


def _read_toml(folder: Path) -> tuple[dict[str, Any] | None, list[Problem]]:
    path = folder / CASE_FILE
    if (refused := not_in_utf8(folder)) is not None:
        return None, [Problem(refused.what, refused.where, refused.fix)]
    if not folder.is_dir():
        is_file = folder.is_file() and folder.name == CASE_FILE
        fix = f"give its folder, {folder.parent}" if is_file else "give a folder that contains a case.toml"
        return None, [Problem(f"there is no case folder {folder}", str(folder), fix)]
    if not path.is_file():
        subject = shlex.quote(str(folder / "subject"))
        fix = f"give the folder that contains it; `limbcli new {subject}` writes one to fill in"
        return None, [Problem("the folder contains no case.toml", str(folder), fix)]
    try:
        return read_toml(path), []
    except UnicodeDecodeError as error:
        return None, [Problem(f"case.toml is not UTF-8 text: {error}", str(path), "save it as UTF-8")]
    except ValueError as error:
        what = f"case.toml is not valid TOML: {error}"
        return None, [Problem(what, str(path), toml_fix(path, error))]


def _read_sites(tables: object, reading: CaseReading, imaging: Imaging) -> list[Site]:
    if isinstance(tables, dict):
        reading.wrong("[site] is a single table, but sites are a list", "write [[site]], with two brackets")
        return []
    if not isinstance(tables, list) or not tables:
        fix = "add a [[site]] (see the case format); `segment`, `limb --c-kpa`, `socket`, `report` need none"
        reading.wrong("case.toml has no site", fix)
        return []
    sites: list[Site] = []
    names: dict[str, str] = {}
    for k, table in enumerate(tables, 1):
        site = _read_site(table, reading, imaging, label=f"site {k}")
        if site is None:
            continue
        first = names.setdefault(schema.folder_key(site.name), site.name)
        if first == site.name and any(each.name == first for each in sites):
            reading.wrong(f"two sites are named {site.name!r}", "give each its own name")
        elif first != site.name:
            what = f"the sites {first!r} and {site.name!r} share a folder where names ignore case"
            reading.wrong(what, "give each a name that differs by more than capitals")
        sites.append(site)
    check_fibres(sites, imaging, reading)
    return sites


def _read_site(table: object, reading: CaseReading, imaging: Imaging, *, label: str) -> Site | None:
    own = reading.part()
    values = own.table(table, site_schema(table), label)
    if not values:
        return None
    label = f"site {values['name']}" if values.get("name") else label
    given = [key for key in ("position_mm", "marker") if isinstance(table, dict) and key in table]
    check_place(values, given, imaging, label, own)
    if imaging.shape is not None and not given:
        values["position_mm"] = imaging.shape.place
    states, unloaded = read_states(values, own, label)
    noise = own.table(values.get("noise") or {}, schema.NOISE, f"{label} noise")
    instruments = read_instruments(values, own, label)
    layers = read_layers(values["layers"], label, own)
    fibres = read_fibres(values, label, own)
    paths: dict[str, Path | None] = {}
    for key, is_folder in (("levels", False), ("trace", False), ("swe_maps", True)):
        made = {"levels": bool(instruments), "swe_maps": "swe_images" in instruments}.get(key, False)
        if made and isinstance(values.get(key), str):
            paths[key] = own.placed(values[key], f"{label}: {key}")
        else:
            paths[key] = own.existing(values.get(key), f"{label}: {key}", is_folder=is_folder)
    levels = states[0].levels if states else paths["levels"]
    if own.problems or levels is None:
        return None
    position, long_axis, skin_bone = (values[key] for key in ("position_mm", "long_axis", "skin_bone_mm"))
    return Site(
        name=values["name"],
        position=point(position) if position else None,
        marker=values["marker"],
        long_axis=long_axis if isinstance(long_axis, str) else point(long_axis),
        levels=levels,
        trace=paths["trace"],
        swe_maps=paths["swe_maps"],
        density_kg_per_m3=float(values["density_kg_per_m3"]),
        noise=_stated_noise(noise),
        instruments=instruments,
        layers=layers,
        skin_bone=None if skin_bone is None else float(skin_bone),
        fibres=fibres,
        states=states,
        unloaded=unloaded,
    )


def _stated_noise(table: Mapping[str, Any]) -> StatedNoise:
    return StatedNoise(
        force=float(table["force_n"]),
        depth=float(table["depth_mm"]),
        swe_level_fraction=float(table["swe_level_fraction"]),
        swe_pixel_fraction=float(table["swe_pixel_fraction"]),
        layer=float(table["layer_mm"]),
        source=table["source"],
    )
