"""A case that reports what is asked of it, so that a result can record the inputs it was made from.

Names: "imaging", "probe", "socket", "sites", "subject/limb", "model/margin", "site/p1/noise"; of files and
folders: "imaging/mri", "site/p1/levels", "site/p1/state/short".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any, TypeVar, cast

from limbcli.case import Case, Imaging, ModelOptions, Site
from limbcli.case.parts import StretchState
from limbcli.case.schema import INSTRUMENTS

Tell = Callable[[str, bool], None]
Part = TypeVar("Part", Case, Site, Imaging, ModelOptions, StretchState)

# Keys that belong together have one name; the names of parts, and what they are called in texts, have none.
_TOGETHER = {"position": "place", "marker": "place", "unloaded": "states"}
_LABELS = {
    Case: {"folder", "subject"}, Site: {"name"}, StretchState: {"name", "stretch"},
}  # fmt: skip
_SOCKET = "socket"  # read from the raw table
_TELL, _PLAIN, _PREFIX, _NOT_OF_CASE = "_tell", "_plain", "_prefix", "_not_of_case"


def noting(case: Case, tell: Tell) -> Case:
    """The same case; `tell` is called with the name of what is asked of it, and whether it names a file."""
    parts: dict[str, Any] = {
        "sites": tuple(_noting_site(each, tell) for each in case.sites),
        "imaging": _wrapped(case.imaging, tell, "imaging"),
        "model": _wrapped(case.model, tell, "model/"),
    }
    return _wrapped(case, tell, "", raw=_Raw(case.raw, tell), **parts)


def unnoted(part: Part) -> Part:
    """The case or part itself, for questions that no result depends on: checks, warnings, captions."""
    return cast(Part, vars(part).get(_PLAIN, part))


def with_values(site: Site, **values: Any) -> Site:
    """A copy of a site with other values, which are no longer those of the case and are not reported."""
    if _TELL not in vars(site):
        return replace(site, **values)
    own = vars(site)
    return _wrapped(
        replace(own[_PLAIN], **values), own[_TELL], own[_PREFIX],
        not_of_case=own[_NOT_OF_CASE] | set(values), states=own["states"],
    )  # fmt: skip


def noting_site(case: Case, site: Site) -> Site:
    """The site of a noting case that a site is or was made from; what differs is not of the case."""
    own = case.site(site.name)
    made = {each.name: getattr(unnoted(site), each.name) for each in fields(Site)}
    values = {name: value for name, value in made.items() if value is not vars(unnoted(own))[name]}
    return with_values(own, **values) if values else own


def _noting_site(site: Site, tell: Tell) -> Site:
    prefix = f"site/{site.name}/"
    states = tuple(_wrapped(each, tell, f"{prefix}state/{each.name}") for each in site.states)
    return _wrapped(site, tell, prefix, states=states)


def _wrapped(
    part: Part, tell: Tell, prefix: str, *, not_of_case: frozenset[str] = frozenset(), **changes: Any
) -> Part:
    """A copy of a part, of a class that reports what is asked of it."""
    kind: Any = type(part)
    found: Part = object.__new__(_noting_class(kind))
    values = {**vars(part), **changes}
    vars(found).update(values, **{_TELL: tell, _PLAIN: part, _PREFIX: prefix, _NOT_OF_CASE: not_of_case})
    return found


@cache
def _noting_class(kind: type) -> type:
    known = {each.name for each in fields(kind)} - _LABELS.get(kind, set())

    def read(self: Any, name: str) -> Any:
        if name in known:
            own = object.__getattribute__(self, "__dict__")
            if name not in own[_NOT_OF_CASE]:
                for key, is_file in _names(kind, own, name):
                    own[_TELL](key, is_file)
        return object.__getattribute__(self, name)

    def site(self: Case, name: str) -> Site:
        """One site: that there are others does not matter."""
        found = unnoted(self).site(name)
        return next(each for each in vars(self)["sites"] if unnoted(each) is found)

    own = {"__getattribute__": read, **({"site": site} if kind is Case else {})}
    return type(kind.__name__, (kind,), own)


def _names(kind: type, own: Mapping[str, Any], name: str) -> Iterator[tuple[str, bool]]:
    """Names under which a field is reported, and whether they are those of files."""
    value, prefix = own[name], own[_PREFIX]
    if kind is Case:
        if name not in ("imaging", "model", "raw"):  # which report themselves
            yield ("subject/limb" if name == "limb" else name), False
    elif kind is Imaging:
        yield prefix, False
        several = {"labels": own[_PLAIN].label_maps if value else (), "bones": value}
        if name in several:
            first = "" if name == "labels" else "/0"
            yield from (
                (f"{prefix}/{name}" + (f"/{k}" if k else first), True) for k in range(len(several[name]))
            )
        elif value is not None and _is_path(kind, name):
            yield f"{prefix}/{name}", True
    elif kind is StretchState:
        yield prefix, True
    elif name == "instruments":
        yield from ((f"{prefix}{each}", is_file) for each in INSTRUMENTS for is_file in (False, True))
    else:
        yield f"{prefix}{_TOGETHER.get(name, name)}", _is_path(kind, name)


@cache
def _is_path(kind: type, name: str) -> bool:
    return any(each.name == name and "Path" in str(each.type) for each in fields(kind))


class _Raw(Mapping[str, Any]):
    """The raw tables of a case, of which only [socket] is read outside of the case itself."""

    def __init__(self, tables: Mapping[str, Any], tell: Tell):
        self._tables, self._tell = tables, tell

    def __getitem__(self, name: str) -> Any:
        if name == _SOCKET:
            self._tell(_SOCKET, False)
            self._tell(f"{_SOCKET}/surface", True)
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)
