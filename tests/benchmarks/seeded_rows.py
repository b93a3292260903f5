"""The rows of a study in a file, a JSON line each: made once, in one process or in several.

A study that was interrupted is called again and goes on: what has a row already is not made anew.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from limbcli.errors import LimbError

Job = TypeVar("Job")
Row = dict[str, Any]
Key = tuple[Any, ...]  # what tells a row from all others: a seed, an arm and a seed
NO_RESULT = "no_result"  # key of the reason in a row without a result


def kept(path: Path | None) -> list[Row]:
    """The rows that are in the file; none if there is no file."""
    if path is None or not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def made(
    path: Path | None,
    jobs: Mapping[Key, Job],
    one: Callable[[Job], Row | list[Row]],
    *,
    key: tuple[str, ...] = ("seed",),
    processes: int = 1,
    show: Callable[[Row], str] | None = json.dumps,
    until: float = np.inf,
) -> list[Row]:
    """All rows of the file, after those that it lacks were made and added.

    path : None: nothing is kept
    jobs : what `one` is called with, by the values of the row's key; key : their names in the row
    one : makes the row, or several of the same key; a LimbError of it makes a row with `no_result`
    show : what is printed of a new row
    until : of `time.monotonic`; none is begun after it
    """
    rows = kept(path)
    done = {tuple(row[name] for name in key) for row in rows}
    todo = {values: job for values, job in jobs.items() if values not in done}
    for values, found in zip(
        todo, _results(partial(_tried, one, until), todo.values(), processes), strict=True
    ):
        for each in found:
            rows.append(json.loads(json.dumps(dict(zip(key, values, strict=True)) | each, default=float)))
            if path is not None:
                with path.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(rows[-1]) + "\n")
            if show is not None:
                print(show(rows[-1]), flush=True)
    return rows


def _tried(one: Callable[[Job], Row | list[Row]], until: float, job: Job) -> list[Row]:
    if time.monotonic() > until:
        return []
    try:
        found = one(job)
    except LimbError as error:
        return [{NO_RESULT: error.what}]
    return found if isinstance(found, list) else [found]


def _results(one: Callable[[Job], list[Row]], jobs: Iterable[Job], processes: int) -> Iterator[list[Row]]:
    if processes == 1:
        yield from map(one, jobs)
        return
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(one, jobs)


def succeeded(rows: Iterable[Row]) -> list[Row]:
    """Those that have a result."""
    return [row for row in rows if NO_RESULT not in row]


def counted(rows: list[Row]) -> str:
    return f"{len(rows)} seeds, {len(rows) - len(succeeded(rows))} without a result"


def held(rows: list[Row], name: str) -> str:
    """How often a parameter's interval holds the truth, of the rows that have one."""
    good = succeeded(rows)
    inside = sum(row[f"{name}_covered"] for row in good)
    return (
        f"{name}: truth inside {inside} of {len(good)}; median {np.median([row[name] for row in good]):.4g}"
    )
