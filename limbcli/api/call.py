"""Common entry of all functions: open the case, lock the output folder, and convert errors."""

from __future__ import annotations

import contextlib
import functools
import os
import reprlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar, Union

from limbcli.api.limits import check_arguments
from limbcli.config import at_home, default_out
from limbcli.errors import CaseError
from limbcli.errors.file_system import NO_MEMORY, in_words
from limbcli.files.output_lock import one_writer
from limbcli.options import arguments_of, documented, plain_signature
from limbcli.progress import SILENT, Listener, Progress
from limbcli.results import CALLED

if TYPE_CHECKING:  # without numpy, which help and messages do not need
    from limbcli.case import Case

PathLike: TypeAlias = str | os.PathLike[str]
CaseLike: TypeAlias = Union["Case", str, os.PathLike[str]]
Heard: TypeAlias = Listener | Progress | None
_Taken = ParamSpec("_Taken")
_Found = TypeVar("_Found")
_Given = TypeVar("_Given")


def public(
    convert: Callable[[_Found], _Given], returns: str
) -> Callable[[Callable[_Taken, _Found]], Callable[_Taken, _Given]]:
    """Decorator of a public function.

    Its arguments are checked and listed in its documentation, as their options state. The call is recorded in
    its results, as a command records its command line. What the stage returned becomes a public result.

    convert : makes the public result, of the type that `returns` names
    """

    def decorate(function: Callable[_Taken, _Found]) -> Callable[_Taken, _Given]:
        arguments = arguments_of(function)

        @functools.wraps(function)
        def calling(*args: _Taken.args, **kwargs: _Taken.kwargs) -> _Given:
            given = {name: value for name, value in kwargs.items() if name != "progress"}
            words = [*map(_in_words, args), *(f"{name}={_in_words(value)}" for name, value in given.items())]
            check_arguments(function.__name__, arguments, kwargs)
            before = CALLED.set(f"limbcli.{function.__name__}({', '.join(words)})")
            try:
                return convert(function(*args, **kwargs))
            finally:
                CALLED.reset(before)

        calling.__doc__ = documented(function.__doc__ or "", arguments)
        calling.__signature__ = plain_signature(function, returns)  # type: ignore[attr-defined]
        return calling

    return decorate


def _in_words(value: object) -> str:
    """
    >>> _in_words(Path("my limb")), _in_words(2.5)
    ("'my limb'", '2.5')
    """
    from limbcli.case import Case

    value = value.folder if isinstance(value, Case) else value
    return repr(os.fspath(value)) if isinstance(value, os.PathLike) else repr(value)


@dataclass(frozen=True)
class StageCall:
    """A case at work: the arguments common to all stage calls."""

    case: Case
    out: Path
    progress: Progress

    def run(self, stage: Callable[..., _Found], **given: Any) -> _Found:
        """What a stage returns for these arguments; sites and paths are as the caller gave them."""
        given |= {name: maybe_path(given[name], name) for name in ("febio", "templates") if name in given}
        if "sites" in given:
            given["sites"] = names_of(given["sites"])
        return stage(self.case, out=self.out, progress=self.progress, **given)


@contextlib.contextmanager
def at_work(
    case: CaseLike, out: PathLike | None, *, wait: bool, progress: Heard, images_only: bool = False,
    sites_or_none: bool = False,
) -> Iterator[StageCall]:  # fmt: skip
    """Open the case and lock its output folder for writing.

    images_only : of a case that is given by its folder, probe and sites may be missing
    sites_or_none : it may have no sites, but those that it has are complete

    Raises
    ------
    CaseError
        If the case cannot be used, or another process writes into the folder and `wait` is False.
    ToolError
        If the disk is full or there is not enough memory.
    """
    from limbcli.case import Case

    opening = Case.open_images if images_only else Case.open_limb if sites_or_none else Case.open
    with foreseen():
        opened = _still_there(case) if isinstance(case, Case) else opening(folder_of(case, "case"))
    with writing(opened.folder, out, wait=wait, progress=progress) as (target, heard):
        yield StageCall(opened, target, heard)


@contextlib.contextmanager
def writing(
    source: Path, out: PathLike | None, *, wait: bool, progress: Heard
) -> Iterator[tuple[Path, Progress]]:
    """Lock an output folder for writing; the folder, by default named after the source, and the listener.

    Raises as `at_work`.
    """
    with foreseen():
        target = default_out(source) if out is None else folder_of(out)
        heard = listening(progress)
        with one_writer(target, wait=wait, progress=heard):
            yield target, heard


def _still_there(case: Case) -> Case:
    if not case.file.is_file():
        raise CaseError(
            f"the case that was opened from {case.folder} was not found from {Path.cwd()}",
            where=str(case.file),
            fix="open it by its full path, or open it again at its present location",
        )
    return case


@contextlib.contextmanager
def foreseen() -> Iterator[None]:
    """Convert file-system errors and lack of memory inside the block into errors that give a fix."""
    try:
        yield
    except OSError as error:
        found = in_words(error)
        if found is None:
            raise
        raise found from error
    except MemoryError as error:
        raise NO_MEMORY from error


def listening(progress: Heard) -> Progress:
    """Adapt a listener `f(kind, facts)` to the stages' interface; None: no listener.

    Raises
    ------
    CaseError
        If it is not callable.
    """
    if progress is None:
        return SILENT
    if isinstance(progress, Progress):
        return progress
    if not callable(progress):
        raise CaseError(
            f"progress is {progress!r}, which cannot be called",
            where="progress",
            fix="give a function of (kind, facts), or omit it for no output",
        )
    return Progress(progress)


def folder_of(path: PathLike, name: str = "out") -> Path:
    """Path given by the caller, with `~` expanded to the home folder.

    Raises
    ------
    CaseError
        If it is not a path.
    """
    if isinstance(path, str | os.PathLike):
        return at_home(Path(path))
    what = f"{name} is {reprlib.repr(path)}, not a path"
    raise CaseError(what, where=name, fix="give a path, as str or pathlib.Path")


def maybe_path(path: PathLike | None, name: str) -> Path | None:
    return None if path is None else folder_of(path, name)


def names_of(sites: str | Iterable[str] | None, name: str = "sites") -> list[str] | None:
    """Names given by the caller; None: all.

    Raises
    ------
    CaseError
        If they are not names, or the selection is empty: an empty selection does not mean all.

    >>> names_of("p1"), names_of(("p1", "p2")), names_of(None)
    (['p1'], ['p1', 'p2'], None)
    """
    if sites is None:
        return None
    found = [sites] if isinstance(sites, str) else list(sites) if isinstance(sites, Iterable) else [sites]
    if not found or not all(isinstance(each, str) for each in found):
        what = f"{name} is {sites!r}, " + ("not a name or several" if found else "which names nothing")
        raise CaseError(what, where=name, fix="give one or several names, or omit it for all")
    return found
