"""Which stages of a batch need not be run again.

A stage is fresh when nothing that went into it changed (files, options, the code,
the stages before it) and nothing that it left was touched since.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from limbcli.config import templates_folder
from limbcli.errors import CaseError
from limbcli.files import atomic_file, sha256
from limbcli.results import read_result, stage_folder

MEMORY = ".batch.json"


@cache
def code_hash() -> str:
    """Hash of the package's sources and templates (hex)."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for root, pattern in ((package, "*.py"), (templates_folder(), "*.j2")):
        for path in sorted(root.rglob(pattern)):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def key_of(*parts: object) -> str:
    """One hash of what a stage depends on; paths count by their content."""
    digest = hashlib.sha256()
    for part in parts:
        content = sha256(part) if isinstance(part, Path) else repr(part)
        digest.update(content.encode() + b"\0")
    return digest.hexdigest()


_ASKED, _SUBJECT = "asked", "subject"


class Memory:
    """What the last batch into this output folder did: a key and an output hash per stage.

    And what stages were asked for by hand before it (see `asked`). What was done for another subject
    is forgotten.
    """

    def __init__(self, out: Path, subject: str = ""):
        self._path = out / MEMORY
        self._out, self._subject = out, subject
        try:
            self._done: dict[str, Any] = json.loads(self._path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            self._done = {}
        if not isinstance(self._done, dict) or self._done.get(_SUBJECT, subject) != subject:
            self._done = {}
        self._done.setdefault(_ASKED, {})
        self._done[_SUBJECT] = subject

    def is_fresh(self, stage: str, site: str | None, key: str) -> bool:
        folder = stage_folder(self._out, stage, site)
        remembered = self._done.get(_name(stage, site))
        if remembered is None or not (folder / f"{stage}.json").is_file():
            return False
        return remembered == [key, sha256(folder)]

    def made_since(self, stage: str, site: str | None) -> bool:
        """Whether the stage's result is not the one that was remembered: made, or made again, by hand."""
        remembered = self._done.get(_name(stage, site))
        return remembered is None or remembered[1] != sha256(stage_folder(self._out, stage, site))

    def remember(self, stage: str, site: str | None, key: str) -> None:
        folder = stage_folder(self._out, stage, site)
        self._done[_name(stage, site)] = [key, sha256(folder)]
        self._write()

    def asked(self, stage: str, site: str | None) -> dict[str, Any]:
        """The options a stage was last called with by hand: of a result made since, else as kept."""
        if self.made_since(stage, site):
            with contextlib.suppress(CaseError):
                found = read_result(self._out, stage, site=site)
                is_ours = self._subject in ("", found.subject)
                return dict(found.data.get("asked", {})) if is_ours else {}
        return dict(self._done[_ASKED].get(_name(stage, site), {}))

    def keep_asked(self, stage: str, site: str | None, asked: Mapping[str, Any]) -> None:
        """Keep them for batches to come, should the result they were read from go."""
        if self._done[_ASKED].get(_name(stage, site), {}) != asked:
            self._done[_ASKED][_name(stage, site)] = dict(asked)
            self._write()

    def _write(self) -> None:
        with atomic_file(self._path) as path:
            path.write_text(json.dumps(self._done, indent=1), encoding="utf-8")


def _name(stage: str, site: str | None) -> str:
    return f"{stage}/{site}" if site else stage
