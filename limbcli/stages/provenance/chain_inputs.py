"""Inputs that a stage takes from the case, by names that do not depend on the location of the case.

A role names a file or folder ("site/p1/levels", "imaging/mri"), a key names values of case.toml
("site/p1/place", "probe"). A role can also be the absolute path of a file outside the case.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from limbcli.case import Case, Site
from limbcli.case.socket import socket_of
from limbcli.results import StageWriter, plain

SITES, LIMB = "sites", "subject/limb"
_WORDS = {"place": "place (position_mm, marker)", "skin_bone": "skin_bone_mm"}


def input_path(case: Case, role: str) -> Path | None:
    """Current path of the file or folder of a role; None if the case names none."""
    if Path(role).is_absolute():
        return Path(role)
    section, name, *rest = role.split("/")
    if section == "imaging":
        return _image(case, name, rest)
    if section == "socket":
        found_socket = socket_of(case)
        return None if found_socket is None else found_socket.surface
    site = _site(case, name)
    if site is None:
        return None
    kind, *inside = rest
    if kind == "state":
        return next((each.levels for each in site.states if [each.name] == inside), None)
    instrument = site.instruments.get(kind)
    found: Path | None = instrument["path"] if instrument else getattr(site, kind, None)
    return found.joinpath(*inside) if found is not None else None


def case_value(case: Case, key: str) -> Any:
    """Current value of a key, with defaults filled in; None if the case has none."""
    section, *rest = key.split("/")
    if section == SITES:
        return [each.name for each in case.sites]
    if section in ("imaging", "socket"):
        return plain(case.raw.get(section))
    if section == "subject":
        return getattr(case, rest[0])
    if section == "site":
        site = _site(case, rest[0])
        return None if site is None else plain(_of_site(site, rest[1]))
    found = plain(vars(getattr(case, section)))
    return found[rest[0]] if rest else found


def is_unchanged(case: Case, key: str, before: Any) -> bool:
    """Whether the value of a key equals the recorded one; the name of a probe is ignored."""
    now = case_value(case, key)
    if key == "probe" and isinstance(before, Mapping):
        return {**before, "name": ""} == {**now, "name": ""}
    return bool(now == before)


def note_case(
    writer: StageWriter, case: Case, keys: Iterable[str], *, site: Site | None = None, own: Iterable[str] = ()
) -> None:
    """Record these keys of the case, and the keys `own` of one site, as inputs of a result."""
    several = [*keys, *(f"site/{site.name}/{each}" for each in own if site is not None)]
    writer.made_from["case"].update({key: case_value(case, key) for key in several})


def note_templates(writer: StageWriter, templates: Path | None) -> None:
    """Record the user's templates of model files as inputs; templates of pages do not affect the result."""
    if templates is not None and (templates / "feb").is_dir():
        writer.used("templates", templates / "feb", role=str((templates / "feb").resolve()))


def in_words(key: str) -> str:
    """
    >>> in_words("site/p1/place"), in_words("model/margin"), in_words("imaging/mri")
    ('place (position_mm, marker) of site p1', 'model.margin', 'imaging.mri')
    """
    if key.startswith("site/"):
        _, name, *rest = key.split("/")
        words = "/".join(rest)
        return f"{_WORDS.get(words, words)} of site {name}"
    return key if Path(key).is_absolute() else key.replace("/", ".")


def _image(case: Case, name: str, rest: list[str]) -> Path | None:
    if name == "bones":
        number = int(rest[0])
        return case.imaging.bones[number] if number < len(case.imaging.bones) else None
    if name == "labels":
        number, sources = int(rest[0]) if rest else 0, case.imaging.label_maps
        return sources[number].path if number < len(sources) else None
    found: Path | None = getattr(case.imaging, name)
    return found


def _site(case: Case, name: str) -> Site | None:
    return next((each for each in case.sites if each.name == name), None)


def _of_site(site: Site, key: str) -> Any:
    if key == "place":
        return {"position_mm": site.position, "marker": site.marker}
    if key == "noise":
        return vars(site.noise)
    if key == "fibres":
        return asdict(site.fibres)
    if key == "states":
        stretches = [{"name": each.name, **asdict(each.stretch)} for each in site.states]
        return {"told": stretches, "unloaded": asdict(site.unloaded)}
    if key in site.instruments:
        return {name: value for name, value in site.instruments[key].items() if name != "path"}
    return getattr(site, key, None)
