"""One damaged file, read: what became of it."""

from __future__ import annotations

import signal
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.errors import LimbError
from limbcli.errors.problems import errors_of
from tests.fuzz.mutations import mutated
from tests.fuzz.targets import Target

GOOD = ("refused", "read")
LIMIT_S = 30


class Hang(BaseException):
    """The reader took too long."""


@dataclass(frozen=True)
class Trial:
    """outcome : "refused" (an error of limbcli's families), "read" (what was read is sound), else a fault:
    "traceback", "unsound", "hang", "memory"; detail : of a fault"""

    outcome: str
    detail: str = ""


def try_one(target: Target, folder: Path, good: bytes, seed: tuple[int, ...]) -> Trial:
    """Damage the target's file by the seed and read it."""
    (folder / target.file).write_bytes(mutated(good, np.random.default_rng(seed), text=target.text))
    return judge(target, folder)


def judge(target: Target, folder: Path) -> Trial:
    try:
        with warnings.catch_warnings(), at_most(LIMIT_S):
            warnings.simplefilter("ignore")
            found = target.read(folder / target.file)
            if isinstance(found, tuple) and isinstance(found[1], list) and errors_of(found[1]):
                return Trial("refused")
            return (
                Trial("read") if target.sound(found) else Trial("unsound", "an impossible value came through")
            )
    except LimbError as error:
        return Trial("refused") if error.fix else Trial("traceback", "no way out is told")
    except Hang:
        return Trial("hang", f"over {LIMIT_S} s")
    except MemoryError as error:
        return Trial("memory", str(error))
    except Exception as error:
        return Trial("traceback", f"{type(error).__name__}: {error} {_where(error)}")


def _where(error: BaseException) -> str:
    """The last place of our own that the error passed."""
    place, trace = "", error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if "limbcli/" in file:
            place = f"({file.rsplit('limbcli/', 1)[1]}:{trace.tb_lineno})"
        trace = trace.tb_next
    return place


@contextmanager
def at_most(seconds: float) -> Any:
    def ring(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
