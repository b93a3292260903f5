"""Base class of all results, and results of several sites together."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, ParamSpec, Self, SupportsIndex, TypeVar, overload

from limbcli.api.call import folder_of, public
from limbcli.api.notebook import findings, html_picture, html_table
from limbcli.api.tables import Row, Tabular
from limbcli.errors import CaseError
from limbcli.results import StageResult, plain, read_result, stage_folder

if TYPE_CHECKING:
    from limbcli.api.call import PathLike


@dataclass(frozen=True, eq=False)
class Result(Tabular):
    """Result of a stage: its numbers as attributes, and all its other output.

    Attributes
    ----------
    stage_result : the result as plain values; `stage_result.data` is the content of the stage's JSON file
    """

    stage: ClassVar[str] = ""
    stage_result: StageResult = field(repr=False)

    def __post_init__(self) -> None:
        home = replace(self.stage_result, folder=self.stage_result.folder.absolute())
        object.__setattr__(self, "stage_result", home)
        super().__post_init__()

    @classmethod
    def of(cls, found: StageResult) -> Self:
        """Build from what a stage returned.

        A field is the value of that name in the stage's data, or of the name (nested ones joined by "/") or
        function in its metadata; a path is a file of that name.
        """
        own = [each for each in fields(cls) if each.name != "stage_result" and each.init]
        return cls(found, **{each.name: _field(each, found) for each in own})

    @classmethod
    def read(cls, out: PathLike, site: str | None = None) -> Self:
        """The result that an earlier run wrote to the output folder `out`.

        Raises
        ------
        CaseError
            If the stage has not been run for that site, or its result cannot be read.
        """
        _refuse_other_site(folder_of(out), cls.stage, site)
        return cls.of(read_result(folder_of(out), cls.stage, site=site))

    @property
    def subject(self) -> str:
        """The subject's id, as case.toml gives it."""
        return self.stage_result.subject

    @property
    def site(self) -> str | None:
        """The site's name; None for a result of the whole subject."""
        return self.stage_result.site

    @property
    def folder(self) -> Path:
        """Folder of the stage's files."""
        return self.stage_result.folder

    @property
    def files(self) -> Mapping[str, Path]:
        """All files of the result, by short name."""
        return {name: self.stage_result.path(name) for name in self.stage_result.files}

    @property
    def summary(self) -> tuple[str, ...]:
        """The findings, one per line, as the command line prints them."""
        return self.stage_result.summary

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may be wrong with the result, including the warnings of earlier stages."""
        return self.stage_result.warnings

    @property
    def data(self) -> Mapping[str, Any]:
        """The content of the stage's JSON file; its keys carry units."""
        return self.stage_result.data

    def rows(self) -> list[dict[str, Any]]:
        """The rows of `table()` as plain values."""
        return [self._named({})]

    def to_json(self) -> dict[str, Any]:
        """The result as the command line's --json prints it."""
        return {**self.stage_result.to_json(), "folder": str(self.folder)}

    def _repr_html_(self) -> str:
        """Notebook representation: findings, warnings, rows, and the result's picture."""
        head = f"<b>{html.escape(self.stage_result.label)}</b>: {html.escape(str(self.folder))}"
        found = findings(self.summary, self.warnings)
        return f"<div>{head}{found}{html_table(self.rows())}{html_picture(self.files)}</div>"

    def __str__(self) -> str:
        lines = [*self.summary, *(f"warning: {each}" for each in self.warnings)]
        return "\n  ".join([f"{self.stage_result.label}: {self.folder}", *lines])

    def _fields(self, *left_out: str) -> dict[str, Any]:
        """The fields other than these, by name."""
        names = [each.name for each in fields(self) if each.name not in ("stage_result", *left_out)]
        return {name: getattr(self, name) for name in names}

    def _named(self, row: Row) -> dict[str, Any]:
        """The row, preceded by subject and site."""
        site = {"site": self.site} if self.site else {}
        return {"subject": self.subject, **site, **plain(row)}


def _field(declared: Field[Any], found: StageResult) -> Any:
    """The value of a result's field; one that may be None may be missing."""
    key = declared.metadata.get("from", declared.name)
    if callable(key):
        return key(found)
    if declared.type == "Path":
        return found.path(key)
    value: Any = found.data
    for name in key.split("/"):
        value = value.get(name) if str(declared.type).endswith("None") else value[name]
    return _tuples(value)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


def _refuse_other_site(out: Path, stage: str, site: str | None) -> None:
    """Raise CaseError where the stage has been run, but the site is missing, misspelt or not applicable."""
    sites = sorted(each.parent.name for each in (out / stage).glob(f"*/{stage}.json"))
    if (stage_folder(out, stage, site) / f"{stage}.json").is_file():
        return
    if sites:
        what = f"there is no result of `{stage}`" + (f" for site {site}" if site else " without a site")
        raise CaseError(what, where=str(out / stage), fix=f"name one of its sites: {', '.join(sites)}")
    if site is not None and (out / stage / f"{stage}.json").is_file():
        what = f"the result of `{stage}` is the whole subject's, not that of site {site}"
        raise CaseError(what, where=str(out / stage), fix="leave the site out")


AnyResult = TypeVar("AnyResult", bound=Result)
_Taken = ParamSpec("_Taken")


@dataclass(frozen=True, eq=False)
class SiteResults(Tabular, Sequence[AnyResult], Generic[AnyResult]):
    """One result per site, in the order of the case; accessible by number, by site name, or all as one table.

    Attributes
    ----------
    results : the results of the sites
    """

    results: tuple[AnyResult, ...]

    @overload
    def __getitem__(self, key: SupportsIndex | str) -> AnyResult: ...

    @overload
    def __getitem__(self, key: slice) -> SiteResults[AnyResult]: ...

    def __getitem__(self, key: SupportsIndex | str | slice) -> AnyResult | SiteResults[AnyResult]:
        if isinstance(key, slice):
            return SiteResults(self.results[key])
        if isinstance(key, SupportsIndex):
            return self.results[key]
        for each in self.results:
            if each.site == key:
                return each
        names = ", ".join(str(each.site) for each in self.results) or "none"
        raise CaseError(
            f"there is no result of a site {key!r}", where="SiteResults", fix=f"the sites are: {names}"
        )

    def __contains__(self, key: object) -> bool:
        """Whether there is a result of the site of that name, or whether that result itself is included."""
        return any(each is key or (each.site is not None and each.site == key) for each in self.results)

    def __len__(self) -> int:
        return len(self.results)

    def __iter__(self) -> Iterator[AnyResult]:
        return iter(self.results)

    def rows(self) -> list[dict[str, Any]]:
        """The rows of all results, concatenated."""
        return [row for each in self.results for row in each.rows()]

    def _repr_html_(self) -> str:
        return "".join(each._repr_html_() for each in self.results)

    def __str__(self) -> str:
        return "\n".join(map(str, self.results))


def one(kind: type[AnyResult]) -> Callable[[Callable[_Taken, StageResult]], Callable[_Taken, AnyResult]]:
    """Decorator of a public function whose stage has one result; see `public`."""
    return public(kind.of, kind.__name__)


def each_site(
    kind: type[AnyResult],
) -> Callable[[Callable[_Taken, Iterable[StageResult]]], Callable[_Taken, SiteResults[AnyResult]]]:
    """Decorator of a public function whose stage has a result of each site; see `public`."""
    return public(lambda found: SiteResults(tuple(map(kind.of, found))), f"SiteResults[{kind.__name__}]")
