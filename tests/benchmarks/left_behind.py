"""What a command left: contents of its files without what tells the time, and files that should be gone."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

from scipy.io import loadmat

from limbcli.results import plain

Content = Mapping[str, str]  # hash by path below the output folder

_TIMED_FILES = {"progress.jsonl", "model.log"}
# `n_solves` is what a call had to do; after a kill, what was kept before it need not be solved again.
_TIMED_KEYS = re.compile(r"(^|_)(seconds|finished_utc|elapsed_s|wall_s|processor_s|n_solves)$")
_TIMES = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?Z?|\d+(\.\d+)? s\b")
_HASH = re.compile(r"[0-9a-f]{64}")
_NEVER_LEFT = (".partial-", ".writing", "limbcli-error-")


def contents(out: Path) -> Content:
    """Hash of every file below the folder, but of those that only tell times."""
    paths = [path for path in sorted(out.rglob("*")) if path.is_file() and path.name not in _TIMED_FILES]
    return {path.relative_to(out).as_posix(): content_hash(path) for path in paths}


def content_hash(path: Path) -> str:
    """Of what the file says apart from times (and, in JSON, hashes of files that tell times)."""
    content = path.read_bytes()
    if path.suffix == ".json":
        try:
            content = json.dumps(without_times(json.loads(content)), sort_keys=True).encode()
        except ValueError:
            content = b"cannot be read " + content
    elif path.suffix == ".mat":
        values = {key: each for key, each in loadmat(path, simplify_cells=True).items() if key[0] != "_"}
        content = json.dumps(without_times(plain(values)), sort_keys=True, default=str).encode()
    elif path.suffix in (".html", ".svg", ".feb", ".csv"):
        content = _TIMES.sub(b"", content)
    return hashlib.sha256(content).hexdigest()


def without_times(value: Any) -> Any:
    """
    >>> without_times({"seconds": 1.5, "data": {"c_kpa": 5.0}, "finished_utc": "2026"})
    {'data': {'c_kpa': 5.0}}
    """
    if isinstance(value, dict):
        return {key: without_times(each) for key, each in value.items() if not _TIMED_KEYS.search(key)}
    if isinstance(value, list):
        return [without_times(each) for each in value]
    if isinstance(value, str):
        return _TIMES.sub(b"", _HASH.sub("", value).encode()).decode()
    return value


def differing(one: Content, other: Content) -> list[str]:
    """Paths that are not in both, or not with the same content."""
    return sorted(name for name in {*one, *other} if one.get(name) != other.get(name))


def halves(out: Path, before: Content, after: Content, itself: Set[str]) -> list[str]:
    """Files at their place after a kill that are neither those before nor those of a whole run."""
    found = []
    for name, content in contents(out).items():
        temporary = any(part.startswith(_NEVER_LEFT) for part in Path(name).parts)
        if temporary or name in itself or content in (before.get(name), after.get(name)):
            continue
        if Path(name).match(".batch*.json") and not _unreadable(out / name):
            continue  # what was done so far; it grows
        found.append(name)
    return found


def _unreadable(path: Path) -> bool:
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return True
    return False


def strays(out: Path, scratch: Path) -> list[str]:
    """Temporary files and folders that are still there: below the output folder, and all in `scratch`."""
    left = [path for path in sorted(out.rglob("*")) if path.name.startswith(_NEVER_LEFT)]
    inner = [str(path.relative_to(out)) for path in left]
    return inner + [f"scratch/{path.name}" for path in sorted(scratch.glob("*"))]
