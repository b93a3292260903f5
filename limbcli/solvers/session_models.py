"""Checks which models one session can solve: they may differ only in materials, curves, steps and records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import LimbModel

_SET_UP = ("mesh", "domains", "bodies", "supports", "drives", "loads", "springs", "contacts")


def check_same_set_up(model: LimbModel, other: LimbModel) -> None:
    """Refuse a model that a session of `model` cannot solve.

    Raises CaseError if they differ in mesh, domains, bodies, supports, drives, loads, springs or contacts,
    which are fixed for a session.
    """
    different = [name for name in _SET_UP if not _alike(getattr(model, name), getattr(other, name))]
    if different:
        raise CaseError(
            f"this model differs in its {' and '.join(different)} from the one of the session",
            where="ReferenceSession.solve",
            fix="use a separate session; one session only solves variants in materials, load "
            "curves, steps and records",
        )


def _alike(a: Any, b: Any) -> bool:
    """Whether two values are equal, including any arrays they contain."""
    if a is b:
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return bool(np.array_equal(a, b))
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_alike, a, b))
    if is_dataclass(a) and type(a) is type(b):
        return all(_alike(getattr(a, each.name), getattr(b, each.name)) for each in fields(a))
    return bool(a == b)
