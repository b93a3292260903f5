"""Which stages of a batch need not be run again.

A stage is fresh (up to date) if its inputs (files, options, the code, preceding stages) and its
outputs have not changed since it was run.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from limbcli.config import PACKAGE, templates_folder
from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file, sha256
from limbcli.results import read_result, stage_folder

MEMORY, MEMORY_OF_SITE = ".batch.json", ".batch-"
_ABSENT = "absent"  # stands in a key for a file that does not exist, e.g. one that `measure` has yet to write


@cache
def code_hash() -> str:
    """Hash of the sources and tables of the whole package, and of its templates (hex)."""
    digest = hashlib.sha256()
    for root, pattern in ((PACKAGE, "*.py"), (PACKAGE, "*.csv"), (templates_folder(), "*.j2")):
        for path in sorted(root.rglob(pattern)):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def key_of(*parts: object) -> str:
    """One hash of everything that a stage depends on; paths are hashed by their content, or as absent."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(_content(part).encode() + b"\0")
    return digest.hexdigest()


def _content(part: object) -> str:
    if not isinstance(part, Path):
        return repr(part)
    return sha256(part) if part.exists() else _ABSENT


_ASKED, _SUBJECT = "asked", "subject"


class Memory:
    """Record of the last batch in this output folder: a key and an output hash for each stage.

    It also stores the options of manual calls before it (see `requested`). A record of another subject is
    discarded.

    site : the site whose stages are recorded; each has its own file, as sites can be run in parallel
    """

    def __init__(self, out: Path, subject: str = "", *, site: str | None = None):
        self._path = out / (f"{MEMORY_OF_SITE}{site}.json" if site else MEMORY)
        self._out, self._subject = out, subject
        self._done = _remembered(self._path, subject)
        self._done.setdefault(_ASKED, {})
        self._done[_SUBJECT] = subject

    def is_fresh(self, stage: str, site: str | None, key: str) -> bool:
        folder = stage_folder(self._out, stage, site)
        remembered = self._done.get(_name(stage, site))
        if remembered is None or not (folder / f"{stage}.json").is_file():
            return False
        return remembered == [key, sha256(folder)]

    def made_since(self, stage: str, site: str | None) -> bool:
        """Whether the stage's result differs from the recorded one, i.e. was made (again) by hand.

        False for a result that was recorded and has been removed.
        """
        remembered, folder = self._done.get(_name(stage, site)), stage_folder(self._out, stage, site)
        return remembered is None or (folder.exists() and remembered[1] != sha256(folder))

    def remember(self, stage: str, site: str | None, key: str) -> None:
        folder = stage_folder(self._out, stage, site)
        self._done[_name(stage, site)] = [key, sha256(folder)]
        self._write()

    def requested(self, stage: str, site: str | None) -> dict[str, Any]:
        """Options of the stage's last manual call: from a result made since the last batch, else stored."""
        if self.made_since(stage, site):
            with contextlib.suppress(CaseError):
                found = read_result(self._out, stage, site=site)
                is_ours = self._subject in ("", found.subject)
                given = found.data.get("asked")
                if isinstance(given, dict):  # missing in the report of a case that could not be read
                    return dict(given) if is_ours else {}
        return dict(self._done[_ASKED].get(_name(stage, site), {}))

    def keep_requested(self, stage: str, site: str | None, requested: Mapping[str, Any]) -> None:
        """Store them for later batches, in case the result from which they were read is removed."""
        if self._done[_ASKED].get(_name(stage, site), {}) != requested:
            self._done[_ASKED][_name(stage, site)] = dict(requested)
            self._write()

    def _write(self) -> None:
        with atomic_file(self._path) as path:
            path.write_text(json.dumps(self._done, indent=1), encoding="utf-8")


def _remembered(path: Path, subject: str) -> dict[str, Any]:
    """The stored record; empty if the file is absent, damaged, or of another subject."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    usable = isinstance(found, dict) and isinstance(found.get(_ASKED, {}), dict)
    if not usable or found.get(_SUBJECT, subject) != subject:
        return {}
    requested = {name: each for name, each in found.get(_ASKED, {}).items() if isinstance(each, dict)}
    done = {name: each for name, each in found.items() if isinstance(each, list) and len(each) == 2}
    return {**done, _ASKED: requested}


def _name(stage: str, site: str | None) -> str:
    return f"{stage}/{site}" if site else stage
