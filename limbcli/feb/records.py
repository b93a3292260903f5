"""FEBio's record files: the quantities that the model logs, step by step.

Each converged step has a block: `*Step`, `*Time`, `*Data`, then one row per item, id first. If the run is
killed, the last block is incomplete, possibly within a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, IntArray

_LARGEST = 1_000_000_000  # largest accepted id or step number


@dataclass(frozen=True, eq=False)
class Records:
    """Content of a record file.

    steps, times : (n_times,)
    ids : (n_items,) as in the file
    values : (n_times, n_items, n_columns)
    truncated : the last block was incomplete and is left out
    """

    steps: IntArray
    times: Array
    ids: IntArray
    values: Array
    truncated: bool


def read_records(path: Path, *, n_columns: int | None = None) -> Records:
    """Read a record file (values separated by comma or space).

    n_columns : expected number if known; else that of the first block

    Raises SolveError if the file is missing, has no complete block, a block before the last one does not fit,
    or a value is not a number.
    """
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise SolveError(
            f"the record file {path.name} is missing ({error.strerror})",
            where=str(path),
            fix="run the simulation again; if it recurs, check the end of model.log",
        ) from error
    blocks = [_block(part) for part in text.split("*Step")[1:]]
    whole = [block is not None and block.rows.size > 0 for block in blocks]
    truncated = bool(blocks) and (not whole[-1] or not text.endswith("\n"))
    kept = [block for block in (blocks[:-1] if truncated else blocks) if block is not None]
    if len(kept) < len(blocks) - truncated:
        raise broken_record(path, "a block in its middle cannot be read")
    if not kept:
        raise broken_record(path, "it contains no complete step")
    shape = (len(kept[0].rows), (n_columns or kept[0].rows.shape[1] - 1) + 1)
    if not truncated and len(kept) > 1 and len(kept[-1].rows) < shape[0]:
        kept, truncated = kept[:-1], True
    for block in kept:
        if block.rows.shape != shape or not np.array_equal(block.rows[:, 0], kept[0].rows[:, 0]):
            raise broken_record(
                path, f"the step at time {block.time:g} holds {block.rows.shape}, not {shape} values"
            )
    values = np.stack([block.rows[:, 1:] for block in kept])
    if not np.isfinite(values).all():
        at = kept[int(np.argwhere(~np.isfinite(values))[0][0])].time
        raise broken_record(path, f"a value at time {at:g} is not a number")
    times = np.array([block.time for block in kept])
    again = np.flatnonzero((np.diff(times) == 0) & (np.diff([block.step for block in kept]) == 0))
    if len(again):  # two steps may print the same time
        raise broken_record(path, f"the step at time {times[again[0]]:g} appears more than once: unconverged")
    if not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise broken_record(path, "its times do not increase from step to step")
    ids = kept[0].rows[:, 0]
    if not np.isfinite(ids).all() or (ids != np.rint(ids)).any() or ids.min() < 1 or ids.max() > _LARGEST:
        raise broken_record(path, "an id in its first column is not a whole number from 1")
    return Records(
        steps=np.array([block.step for block in kept], dtype=np.int64),
        times=times,
        ids=kept[0].rows[:, 0].astype(np.int64),
        values=values,
        truncated=truncated,
    )


@dataclass(frozen=True, eq=False)
class _Block:
    step: int
    time: float
    rows: Array


def _block(text: str) -> _Block | None:
    """One block after its `*Step`, or None if it is incomplete or cannot be read."""
    lines = text.split("\n", 3)
    if len(lines) < 4 or not lines[1].startswith("*Time") or not lines[2].startswith("*Data"):
        return None
    try:
        step, time = int(lines[0].split("=")[1]), float(lines[1].split("=")[1])
        body = lines[3].strip()
        width = len(body.split("\n", 1)[0].replace(",", " ").split())
        values = np.array(body.replace(",", " ").split(), dtype=np.float64)
    except (ValueError, IndexError):
        return None
    if width == 0 or values.size % width or abs(step) > _LARGEST:
        return None
    return _Block(step, time, values.reshape(-1, width))


def broken_record(path: Path, what: str) -> SolveError:
    return SolveError(
        f"the record file {path.name} cannot be used: {what}",
        where=str(path),
        fix="run the simulation again; if it recurs, check the end of model.log",
    )
