"""The case that a simulated one is written as: images copied, case.toml with the new measurements."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.phantom.case_folder import NoiseLaw

_MADE_ANEW = (
    "levels", "trace", "swe_maps", "noise", "state", "unloaded_stretch_along", "unloaded_stretch_around",
)  # fmt: skip


def copy_imaging(case: Case, work: Path) -> None:
    """Images, labels and surfaces under the names that case.toml gives them."""
    table = case.raw["imaging"]
    for name in [*(table[key] for key in ("mri", "labels", "skin") if key in table), *table.get("bones", [])]:
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


def case_table(case: Case, laws: Mapping[str, NoiseLaw]) -> dict[str, Any]:
    """case.toml of the sites measured, each with the noise that it was read with."""
    table = {key: value for key, value in case.raw.items() if key not in ("site", "files")}
    imaging = dict(table["imaging"])
    for key in ("mri", "labels", "skin"):
        if key in imaging:
            imaging[key] = _inside(imaging[key]).as_posix()
    if "bones" in imaging:
        imaging["bones"] = [_inside(each).as_posix() for each in imaging["bones"]]
    sites = [_measured_site(raw, laws[raw["name"]]) for raw in case.raw["site"] if raw["name"] in laws]
    return {**table, "imaging": imaging, "site": sites}


def _measured_site(raw: Mapping[str, Any], law: NoiseLaw) -> dict[str, Any]:
    """A [[site]] table with the measured files' names and the noise they were read with."""
    name = raw["name"]
    kept = {key: value for key, value in raw.items() if key not in _MADE_ANEW}
    files = {"levels": f"{name}/levels.csv", "trace": f"{name}/trace.csv", "swe_maps": f"{name}/swe"}
    return {**kept, **files, "noise": {**vars(law), "source": "spec"}}
