"""Writing a simulated case: copied images, and case.toml with the new measurements."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import CASE_FILE, Case, Site
from limbcli.case.schema import INSTRUMENTS
from limbcli.errors import CaseError
from limbcli.files.detached_data import detached_data
from limbcli.model import Array
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.results import StageResult

_MADE_ANEW = ("levels", "trace", "swe_maps", "noise", *INSTRUMENTS)
_FILES = ("mri", "skin", "fibres")  # keys of [imaging] that name a single file or folder


def check_orientations(sites: Sequence[Site]) -> None:
    """Refuse sites whose pennation refers to the image plane of a site that will not be in the new case.

    Raises CaseError if there is such a site; the message names both.
    """
    names = {"axial", "transverse", *(site.name for site in sites)}
    for site in sites:
        for each in site.fibres.pennation:
            if each.orientation not in names:
                raise CaseError(
                    f"site {site.name} gives its fibres in the image of "
                    f"{each.orientation}, which is not simulated",
                    where="--site",
                    fix=f"add --site {each.orientation}, or give site {site.name} a fibre_direction",
                )


def copy_imaging(case: Case, work: Path) -> None:
    """Copy images, labels and surfaces under the names that case.toml gives them."""
    for name, place in _places(case).items():
        source, target = case.folder / name, work / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copyfile(source, target)
            for data in detached_data(source):
                shutil.copyfile(data, target.with_name(data.name))


def _places(case: Case) -> dict[str, Path]:
    """Path of each image and surface within the new folder, by its name in case.toml.

    Files from outside the case keep their file name; a second file of the same name gets its own folder.
    """
    table = case.raw["imaging"]
    labels = [each["file"] for each in _label_tables(table)]
    names = dict.fromkeys([*(table[key] for key in _FILES if key in table), *labels, *table.get("bones", [])])
    found = {name: Path(name) for name in names if _is_within(name)}
    taken = {*found.values(), Path(CASE_FILE), *(Path(site.name) for site in case.sites)}
    for name in names:
        if name not in found:
            own = Path(os.path.normpath(case.folder.absolute() / name)).name
            free = (Path(own), *(Path(f"outside-{k}") / own for k in range(2, len(names) + 2)))
            found[name] = next(each for each in free if each not in taken)
            taken.add(found[name])
    return found


def _label_tables(imaging: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The label maps of [imaging], each as a table with `file`."""
    raw = imaging.get("labels", [])
    return [
        each if isinstance(each, dict) else {"file": each}
        for each in (raw if isinstance(raw, list) else [raw])
    ]


def _is_within(name: str) -> bool:
    """
    >>> _is_within("mri"), _is_within("../other/mri"), _is_within(".")
    (True, False, False)
    """
    path = Path(name)
    return path != Path() and not path.is_absolute() and ".." not in path.parts


def case_table(case: Case, laws: Mapping[str, NoiseLaw], *, layers: bool = False) -> dict[str, Any]:
    """The content of case.toml for the measured sites, each with the noise of its readings.

    layers : whether layers were read
    """
    table = {key: value for key, value in case.raw.items() if key not in ("site", "files")}
    imaging, places = dict(table["imaging"]), _places(case)
    for key in _FILES:
        if key in imaging:
            imaging[key] = places[imaging[key]].as_posix()
    if "labels" in imaging:
        moved = [{**each, "file": places[each["file"]].as_posix()} for each in _label_tables(imaging)]
        imaging["labels"] = moved[0]["file"] if moved == [{"file": moved[0]["file"]}] else moved
    if "bones" in imaging:
        imaging["bones"] = [places[each].as_posix() for each in imaging["bones"]]
    sites = [
        _measured_site(raw, noise_table(laws[raw["name"]], layers=layers))
        for raw in case.raw["site"]
        if raw["name"] in laws
    ]
    return {**table, "imaging": imaging, "site": sites}


def noise_table(law: NoiseLaw, *, layers: bool) -> dict[str, float]:
    """[site.noise]; that of layers only if they were read."""
    return {key: value for key, value in vars(law).items() if layers or key != "layer_mm"}


def _measured_site(raw: Mapping[str, Any], noise: Mapping[str, float]) -> dict[str, Any]:
    """A [[site]] table with the names of the measured files and the noise of the readings."""
    name = raw["name"]
    kept = {key: value for key, value in raw.items() if key not in _MADE_ANEW}
    stated = {**noise, "source": "spec"}
    if "state" in raw:
        states = [{**each, "levels": f"{name}/{each['name']}/levels.csv"} for each in raw["state"]]
        return {**kept, "state": states, "noise": stated}
    files = {"levels": f"{name}/levels.csv", "trace": f"{name}/trace.csv", "swe_maps": f"{name}/swe"}
    return {**kept, **files, "noise": stated}


def borders_at_rest(segmented: StageResult, site: Site) -> Array:
    """Depths (2,) of the lower borders of skin and fat below the skin, mm, found by `segment` at a site.

    Raises CaseError if `segment` found none.
    """
    layers = (segmented.data.get("layers") or {}).get(site.name)
    if layers is None:
        raise CaseError(
            "the geometry gives no thickness of skin and fat at this site, so layers cannot be simulated",
            where=f"site {site.name}",
            fix="omit --with-layers, or give a case whose images show fat, or [imaging] shape",
        )
    return np.cumsum([float(layers["skin_mm"]), float(layers["fat_mm"])])
