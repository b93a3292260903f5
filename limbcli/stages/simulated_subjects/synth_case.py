"""The case that a simulated one is written as: images copied, case.toml with the new measurements."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError
from limbcli.model import Array
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.results import StageResult

_MADE_ANEW = ("levels", "trace", "swe_maps", "noise")
_FILES = ("mri", "labels", "skin", "fibres")  # of [imaging]


def copy_imaging(case: Case, work: Path) -> None:
    """Images, labels and surfaces under the names that case.toml gives them."""
    table = case.raw["imaging"]
    for name in [*(table[key] for key in _FILES if key in table), *table.get("bones", [])]:
        source, target = case.folder / name, work / _inside(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copyfile(source, target)


def _inside(name: str) -> Path:
    """A path of case.toml as a path within the new folder.

    >>> _inside("../other/mri").as_posix(), _inside("mri").as_posix()
    ('mri', 'mri')
    """
    path = Path(name)
    return Path(path.name) if path.is_absolute() or ".." in path.parts else path


def case_table(case: Case, laws: Mapping[str, NoiseLaw], *, layers: bool = False) -> dict[str, Any]:
    """case.toml of the sites measured, each with the noise that it was read with.

    layers : whether layers were read
    """
    table = {key: value for key, value in case.raw.items() if key not in ("site", "files")}
    imaging = dict(table["imaging"])
    for key in _FILES:
        if key in imaging:
            imaging[key] = _inside(imaging[key]).as_posix()
    if "bones" in imaging:
        imaging["bones"] = [_inside(each).as_posix() for each in imaging["bones"]]
    sites = [
        _measured_site(raw, noise_table(laws[raw["name"]], layers=layers))
        for raw in case.raw["site"]
        if raw["name"] in laws
    ]
    return {**table, "imaging": imaging, "site": sites}


def noise_table(law: NoiseLaw, *, layers: bool) -> dict[str, float]:
    """[site.noise], of layers where they were read."""
    return {key: value for key, value in vars(law).items() if layers or key != "layer_mm"}


def _measured_site(raw: Mapping[str, Any], noise: Mapping[str, float]) -> dict[str, Any]:
    """A [[site]] table with the measured files' names and the noise they were read with."""
    name = raw["name"]
    kept = {key: value for key, value in raw.items() if key not in _MADE_ANEW}
    stated = {**noise, "source": "spec"}
    if "state" in raw:
        states = [{**each, "levels": f"{name}/{each['name']}/levels.csv"} for each in raw["state"]]
        return {**kept, "state": states, "noise": stated}
    files = {"levels": f"{name}/levels.csv", "trace": f"{name}/trace.csv", "swe_maps": f"{name}/swe"}
    return {**kept, **files, "noise": stated}


def borders_at_rest(segmented: StageResult, site: Site) -> Array:
    """mm (2,) below the skin of skin's and fat's lower borders, as `segment` tells them at a site.

    Raises
    ------
    CaseError
        If it tells none.
    """
    told = (segmented.data.get("layers") or {}).get(site.name)
    if told is None:
        raise CaseError(
            "the geometry tells no thickness of skin and fat at this site, so layers cannot be read",
            where=f"site {site.name}",
            fix="leave --with-layers out, or give a case whose images show fat, or [imaging] shape",
        )
    return np.cumsum([float(told["skin_mm"]), float(told["fat_mm"])])
