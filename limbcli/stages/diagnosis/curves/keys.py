"""Keys of cached simulations."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from limbcli.model import Array, LimbModel
from limbcli.results import plain
from limbcli.stages.diagnosis.data.windows import Windows
from limbcli.version import __version__

_READING = 3  # version of the evaluation of speeds; increment on changes, as cached curves contain speeds
READING_OF_FIELDS = 2  # the same for curves with an effect that is a factor on stiffnesses


def changed_to(*models: LimbModel) -> str:
    """Hash of models with effects, so that a modified implementation of an effect is solved again."""
    digest = hashlib.sha256()

    def feed(value: Any) -> None:
        if isinstance(value, np.ndarray):
            digest.update(np.ascontiguousarray(value).tobytes())
        elif is_dataclass(value):
            feed([getattr(value, each.name) for each in fields(value)])
        elif isinstance(value, Mapping):
            feed([[str(key), value[key]] for key in sorted(value, key=str)])
        elif isinstance(value, tuple | list):
            for each in value:
                feed(each)
        else:
            digest.update(f"{plain(value)!r};".encode())

    for model in models:
        feed(model)
    return digest.hexdigest()


def fingerprint(
    model: LimbModel, depths: Sequence[float], c: float, f_kappa: float, windows: Windows,
    *, enough_force: float | None = None, lines: Array | None = None,
    density_kg_per_m3: float = 1000.0,
) -> str:  # fmt: skip
    """Hash of the simulation without effects.

    It covers mesh, contact, depths, tissue and its density, the window and the version of its evaluation, the
    force at which simulations end, the tracked lines, and the program version.
    """
    digest = hashlib.sha256(np.ascontiguousarray(model.mesh.points).tobytes())
    digest.update(f"limbcli {__version__}, read {_READING}".encode())
    penalties = [each.penalty for each in model.contacts]
    contents = [[round(float(d), 6) for d in depths], c, f_kappa, repr(windows), penalties, enough_force]
    contents += [density_kg_per_m3]
    digest.update(json.dumps(contents if lines is None else [*contents, plain(lines)]).encode())
    return digest.hexdigest()[:16]
