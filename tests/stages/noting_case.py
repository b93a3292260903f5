"""A case that notes what is asked of it, by the names under which results record their inputs."""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import dataclass, field, fields
from typing import Any

from limbcli.case import Case, Imaging, ModelOptions, Probe, Site

# Not noted: what asks in order to check or to record inputs, or to copy a whole record.
_RECORDERS = ("limbcli.stages.provenance", "limbcli.case", "limbcli.results", "dataclasses", "copy", "tests")
_PLACE = {"position": "place", "marker": "place", "unloaded": "states"}
_NAMES = {"name", "folder", "subject", "raw", "sites", "probe", "model", "imaging"}  # parts, and labels


@dataclass
class Asked:
    """keys : what was asked, as in `chain_inputs`, and by which functions"""

    keys: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    def note(self, key: str) -> None:
        frame = sys._getframe(2)
        asker = str(frame.f_globals.get("__name__"))
        if not asker.startswith(_RECORDERS):
            self.keys[key].add(f"{asker}.{frame.f_code.co_name}")


def noting(case: Case) -> tuple[Case, Asked]:
    """The same case, and the record of what will be asked of it."""
    asked = Asked()
    classes = {cls: _noting(cls, asked) for cls in (Case, Imaging, ModelOptions, Probe, Site)}

    def copied(value: Any, **changes: Any) -> Any:
        found = object.__new__(classes[type(value)])
        for each in fields(value):
            object.__setattr__(found, each.name, changes.get(each.name, getattr(value, each.name)))
        return found

    parts = {name: copied(getattr(case, name)) for name in ("imaging", "probe", "model")}
    return copied(case, **parts, sites=tuple(copied(site) for site in case.sites)), asked


def _noting(cls: type, asked: Asked) -> type:
    known = {each.name for each in fields(cls)} - _NAMES

    def read(self: Any, name: str) -> Any:
        value = object.__getattribute__(self, name)
        if name in known:
            asked.note(_key(self, cls, name))
        return value

    return type(cls.__name__, (cls,), {"__getattribute__": read})


def _key(owner: Any, cls: type, name: str) -> str:
    if cls is Site:
        return f"site/{object.__getattribute__(owner, 'name')}/{_PLACE.get(name, name)}"
    if cls is ModelOptions:
        return f"model/{name}"
    return {Imaging: "imaging", Probe: "probe"}.get(cls, f"subject/{name}")
