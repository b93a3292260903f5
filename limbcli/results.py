"""The result of a stage: a folder with its files, and one JSON file that describes them.

`<out>/<stage>/<stage>.json`, or `<out>/<stage>/<site>/<stage>.json` for stages that work site by site. Later
stages, the report and the batch read these.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from limbcli.errors import CaseError, LimbError, errors_of_site
from limbcli.errors.pasted_commands import command_line
from limbcli.files.atomic import atomic_folder, sha256
from limbcli.version import __version__

FORMAT = 1
CALLED: ContextVar[str] = ContextVar("called", default="")  # the current call from Python
ERROR_FILE = "error.json"  # file that a batch writes for a failed stage
# Raised when reading a result that is corrupt or of an older version.
UNLIKE_OURS = (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError)
_PICTURES = (".png", ".svg", ".html")
_DIGEST = "record_sha256"  # in the provenance: hash of the whole record without this entry


@dataclass(frozen=True)
class StageResult:
    """Result of one stage for one case, or for one site of it.

    `files` maps a short name to a path relative to `folder`; `data` holds plain JSON values whose keys carry
    units; `summary` is shown to the user on the terminal, one finding per line; `warnings` are passed on by
    every later stage.
    """

    stage: str
    subject: str
    folder: Path
    site: str | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    data: Mapping[str, Any] = field(default_factory=dict)
    summary: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """Absolute path of one of `files`."""
        return self.folder / self.files[name]

    @property
    def label(self) -> str:
        """Stage and site, as results are referred to: "segment", "mesh p1"."""
        return f"{self.stage} {self.site}" if self.site else self.stage

    def value(self, key: str) -> Any:
        """A value of `data`, with nested keys joined by "/"; None if it does not exist."""
        found: Any = self.data
        for name in key.split("/"):
            found = found.get(name) if isinstance(found, Mapping) else None
        return found

    def to_json(self) -> dict[str, Any]:
        return {"format": FORMAT} | plain({k: v for k, v in vars(self).items() if k != "folder"})


def stage_folder(out: Path, stage: str, site: str | None = None) -> Path:
    """Folder of a stage's result below the output folder."""
    return out / stage / site if site else out / stage


@contextlib.contextmanager
def open_stage(out: Path, stage: str, *, subject: str, site: str | None = None) -> Iterator[StageWriter]:
    """Fill a stage's folder; it is put in place as a whole when the block ends without an error.

    Raises
    ------
    CaseError
        If the existing content is not a result of limbcli and would be lost (`foreign` is among the error's
        facts).
    LimbError
        Any raised in the block, with the site added.

    >>> import tempfile
    >>> out = Path(tempfile.mkdtemp())
    >>> with open_stage(out, "mesh", subject="S1", site="p1") as writer:
    ...     _ = writer.file("picture", "mesh.txt").write_text("hello")
    ...     writer.data["n_nodes"] = 12
    >>> read_result(out, "mesh", site="p1").data["n_nodes"]
    12
    """
    target = stage_folder(out, stage, site)
    with atomic_folder(target) as work:
        writer = StageWriter(stage=stage, subject=subject, site=site, work=work, target=target)
        with errors_of_site(site):
            yield writer
        writer.result = writer.finish()
        _refuse_foreign(target, work, stage)


def _refuse_foreign(target: Path, work: Path, stage: str) -> None:
    """Refuse to replace the user's own: a file, or a folder that shares no name with its replacement."""
    if target.is_dir():
        there = {each.name for each in target.iterdir()}
        if not there or there & {ERROR_FILE, *(each.name for each in work.iterdir())}:
            return
    if target.exists():
        raise CaseError(
            f"the path to which `{stage}` writes its result holds something not made by limbcli, which "
            f"would be replaced",
            where=str(target),
            fix="move it away, or give another --out",
            foreign=str(target),
        )


class StageWriter:
    """Collects the results of a stage while it works in its own folder (`work`).

    result : set once the block of `open_stage` has ended without an error
    """

    result: StageResult

    def __init__(self, *, stage: str, subject: str, site: str | None, work: Path, target: Path):
        self.stage, self.subject, self.site = stage, subject, site
        self.work, self.target = work, target
        self.files: dict[str, str] = {}
        self.data: dict[str, Any] = {}
        self.summary: list[str] = []
        self.warnings: list[str] = []
        self.inputs: dict[str, str] = {}
        self._paths: dict[str, Path] = {}
        self.made_from: dict[str, dict[str, Any]] = {"case": {}, "files": {}, "results": {}}
        self.extra_provenance: dict[str, Any] = {}
        self._start = time.time()

    def file(self, name: str, filename: str) -> Path:
        """Register a file under a short name; returns the path to write it to."""
        self.files[name] = filename
        path = self.work / filename
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def used(self, label: str, path: Path, *, role: str = "", digest: str | None = None) -> None:
        """Record the hash of an input (file or folder).

        role : the input's role in the case, such as "site/p1/levels", or its absolute path; with a role,
            later stages check whether the input has changed
        digest : its hash when it was read; None: that of now
        """
        self.inputs[label] = sha256(path) if digest is None else digest
        self._paths[label] = path
        if role:
            self.made_from["files"][role] = self.inputs[label]

    def used_result(
        self, result: StageResult, *, files: Iterable[str] = (), data: Iterable[str] = ()
    ) -> None:
        """Record which files and data (keys joined by "/") of an earlier result were used for this one."""
        known = result.provenance.get("files_sha256", {})
        link = self.made_from["results"].setdefault(result.label, {"files": {}, "data": {}})
        link["files"].update({name: known.get(name) for name in files})
        link["data"].update({key: result.value(key) for key in data})

    def without_result(self, stage: str, site: str | None) -> None:
        """Record that an earlier result which would have been used does not exist."""
        self.made_from.setdefault("absent", {})[f"{stage} {site}" if site else stage] = True

    def _refuse_changed(self) -> None:
        """Refuse a result of inputs that another program changed in the meantime: it may be of both."""
        for label, path in self._paths.items():
            if path.exists() and sha256(path) != self.inputs[label]:
                raise CaseError(
                    f"{path.name} was changed while `{self.stage}` was at work, which may have read it "
                    "before or after",
                    where=str(path),
                    fix="run the command again, once no other program writes there",
                )

    def finish(self) -> StageResult:
        self._refuse_changed()
        result = StageResult(
            stage=self.stage,
            subject=self.subject,
            site=self.site,
            folder=self.target,
            files=dict(self.files),
            data=plain(self.data),
            summary=tuple(self.summary),
            warnings=tuple(self.warnings),
            provenance={
                **provenance(),
                "seconds": round(time.time() - self._start, 3),
                "inputs_sha256": dict(self.inputs),
                "made_from": {"version": __version__, **plain(self.made_from)},
                "files_sha256": self._hashes(pictures=False),
                "pictures_sha256": self._hashes(pictures=True),
                **self.extra_provenance,
            },
        )
        content = write_sealed(self.work / f"{self.stage}.json", result.to_json())
        return replace(result, provenance=content["provenance"])

    def _hashes(self, *, pictures: bool) -> dict[str, str]:
        """Hashes of the written pictures, or of all other files.

        No stage reads pictures, and a user may open and save them again; the report shows them.
        """
        paths = {name: self.work / each for name, each in self.files.items()}
        return {
            name: sha256(path)
            for name, path in paths.items()
            if path.exists() and (path.suffix in _PICTURES) == pictures
        }


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """A result's record with its own hash in its provenance, by which a change by hand is noticed.

    >>> record = sealed({"data": {"c_kpa": 8.5}, "provenance": {}})
    >>> check_seal(record)
    >>> check_seal(record | {"data": {"c_kpa": 18.5}})
    Traceback (most recent call last):
    ...
    ValueError: it was changed after it was written
    """
    return {**content, "provenance": {**content["provenance"], _DIGEST: _digest(content)}}


def write_sealed(path: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Write a result's record with its own hash, which is returned."""
    own = sealed(content)
    path.write_text(json.dumps(own, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return own


def check_seal(content: Mapping[str, Any]) -> None:
    """Raise ValueError if a record does not have the hash that it was written with."""
    known = content["provenance"].get(_DIGEST)
    if known is None:
        raise ValueError("it has no hash of its own: an earlier limbcli wrote it, or it was changed by hand")
    if known != _digest(content):
        raise ValueError("it was changed after it was written")


def _digest(content: Mapping[str, Any]) -> str:
    own = {name: each for name, each in content["provenance"].items() if name != _DIGEST}
    text = json.dumps({**content, "provenance": own}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def read_result(out: Path, stage: str, *, site: str | None = None) -> StageResult:
    """Read the result of a stage.

    Raises CaseError if the stage has not been run, or its JSON cannot be read, was changed since it was
    written, or belongs to another stage or site.
    """
    folder = stage_folder(out, stage, site)
    with record_of(
        folder / f"{stage}.json", stage, f"limbcli {stage} CASE --out {out}", site=site
    ) as content:
        for name in ("files", "data", "provenance"):
            if not isinstance(content[name], dict):
                raise ValueError(f"`{name}` is not a table")
        for name in ("summary", "warnings"):
            if not all(isinstance(each, str) for each in content[name]):
                raise ValueError(f"`{name}` is not a list of texts")
        check_seal(content)
        found = StageResult(
            stage=content["stage"], subject=content["subject"], site=content["site"], folder=folder,
            files=content["files"], data=content["data"], summary=tuple(content["summary"]),
            warnings=tuple(content["warnings"]), provenance=content["provenance"],
        )  # fmt: skip
        if (found.stage, found.site) != (stage, site):
            raise ValueError(f"it is that of `{found.label}`")
    return found


def result_if_there(out: Path, stage: str, *, site: str | None = None) -> StageResult | None:
    """The result of a stage, or None if there is none that can be read."""
    try:
        return read_result(out, stage, site=site)
    except CaseError:
        return None


def data_if_there(out: Path, stage: str, *, site: str | None = None) -> Mapping[str, Any]:
    """Data of a stage's result; empty if there is none that can be read."""
    found = result_if_there(out, stage, site=site)
    return {} if found is None else found.data


@contextlib.contextmanager
def record_of(path: Path, stage: str, command: str, *, site: str | None = None) -> Iterator[dict[str, Any]]:
    """The content of a result's JSON; what is found wrong with it within the block is a CaseError, too.

    command : that writes it
    """
    if not path.is_file():
        what = f"there is no result of `{stage}`" + (f" for site {site}" if site else "")
        raise CaseError(what, where=str(path.parent), fix=f"run `{command}` first")
    try:
        yield json.loads(path.read_text(encoding="utf-8"))
    except UNLIKE_OURS as error:
        what = f"the result of `{stage}` cannot be read ({error})"
        raise CaseError(what, where=str(path), fix=f"run `{command}` again") from error


def provenance() -> dict[str, Any]:
    """Command (or Python call), versions and unit system of this run."""
    return {
        "limbcli": __version__,
        "command": CALLED.get() or command_line(sys.argv),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "packages": dict(_versions()),
        "units": "mm-N-s (MPa)",
        "finished_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


@functools.cache
def _versions() -> Mapping[str, str]:
    """Versions of the packages that results depend on; reading them takes as long as a small result."""
    from importlib import metadata  # whose own imports would be a third of those of `limbcli --help`

    versions = {}
    for name in ("numpy", "scipy", "numba", "pydicom", "scikit-image", "pymeshlab", "tetgen", "meshio"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def plain(value: Any) -> Any:
    """Plain JSON values: arrays become lists, NaN and infinity become null.

    >>> import numpy as np
    >>> plain({"a": np.array([1.0, np.nan]), "b": np.int64(3), "c": Path("x")})
    {'a': [1.0, None], 'b': 3, 'c': 'x'}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if hasattr(value, "tolist"):  # an array, or a number of numpy
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def error_json(error: LimbError) -> dict[str, Any]:
    """An error as JSON: family, exit code, what, where, fix and facts."""
    return {
        "error": type(error).__name__,
        "exit_code": error.exit_code,
        "what": error.what,
        "where": error.where,
        "fix": error.fix,
        "facts": json.loads(json.dumps(plain(error.facts), default=str)),
    }
