"""Inputs that a stage takes from the case, noted as it asks for them.

Their names do not depend on the location of the case.

A role names a file or folder ("site/p1/levels", "imaging/mri"), a key names values of case.toml
("site/p1/place", "probe"). A role can also be the absolute path of a file outside the case.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from limbcli.case import Case, Site
from limbcli.case.noting import noting, noting_site, unnoted
from limbcli.case.socket import socket_of
from limbcli.files.atomic import sha256
from limbcli.results import StageWriter, plain

SITES, LIMB = "sites", "subject/limb"
_WORDS = {"place": "place (position_mm, marker)", "skin_bone": "skin_bone_mm"}


def input_path(case: Case, role: str) -> Path | None:
    """Current path of the file or folder of a role; None if the case names none."""
    case = unnoted(case)
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
    case = unnoted(case)
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


class CaseInputs:
    """What was asked of a case while a stage was at work, with the values and hashes of that time.

    case : the case as the stage is to use it
    """

    def __init__(self, case: Case):
        self._case = unnoted(case)
        self.case = noting(self._case, self._note)
        self._values: dict[str, Any] = {}
        self._files: dict[str, tuple[Path, str] | None] = {}  # None: there was none
        self._writers: list[StageWriter] = []

    def site(self, site: Site) -> Site:
        """A site as the stage is to use it: of the case, or made from one of it."""
        return noting_site(self.case, site)

    def into(self, writer: StageWriter) -> None:
        """Record in a result what was asked, and what will be."""
        for key in self._values:
            self._record(writer, key, is_file=False)
        for role in self._files:
            self._record(writer, role, is_file=True)
        self._writers.append(writer)

    def _note(self, name: str, is_file: bool) -> None:
        if name in (self._files if is_file else self._values):
            return
        if is_file:
            path = input_path(self._case, name)
            there = path is not None and path.exists()
            self._files[name] = (path, sha256(path)) if path is not None and there else None
        else:
            self._values[name] = case_value(self._case, name)
        for writer in self._writers:
            self._record(writer, name, is_file=is_file)

    def _record(self, writer: StageWriter, name: str, *, is_file: bool) -> None:
        if not is_file:
            writer.made_from["case"][name] = self._values[name]
        elif (found := self._files[name]) is None:
            writer.made_from["files"][name] = None
        else:
            path, digest = found
            writer.used(_label(name, writer.site), path, role=name, digest=digest)


def noted(case: Case, writer: StageWriter) -> Case:
    """The case as a stage is to use it: what is asked of it is recorded in the stage's result."""
    inputs = CaseInputs(case)
    inputs.into(writer)
    return inputs.case


def _label(role: str, site: str | None) -> str:
    """Label of an input on a page.

    >>> _label("site/p1/levels", "p1"), _label("site/p1/levels", None), _label("imaging/bones/0", None)
    ('levels', 'levels p1', 'bones 0')
    """
    section, *rest = role.split("/")
    if section != "site":
        return " ".join(rest)
    own = " ".join(rest[1:])
    return own if rest[0] == site else f"{own} {rest[0]}"


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
