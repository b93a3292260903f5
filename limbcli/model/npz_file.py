"""Store a `LimbModel` in one `.npz` file: exact, portable, and without pickled code.

Arrays are stored as arrays; everything else is one JSON text that refers to them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli import model as nouns
from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file
from limbcli.files.unpacking import DAMAGED, UnpackingBudget, read_npz
from limbcli.model import LimbModel, bodies
from limbcli.numbers import math_expressions
from limbcli.results import plain

FORMAT = 1
_TYPES = {
    each.__name__: each
    for module in (bodies, math_expressions, nouns)
    for each in vars(module).values()
    if isinstance(each, type) and dataclasses.is_dataclass(each) and each.__module__ == module.__name__
}
_TEXT = "model_json"
_LARGEST = 2_000_000_000  # upper limit of the size of a model's arrays, bytes
_DAMAGED = (
    *DAMAGED, LookupError, TypeError, AttributeError, ArithmeticError, AssertionError, MemoryError,
)  # fmt: skip


def model_hash(*models: LimbModel) -> str:
    """Hash of everything in these models, from which results are told to be of the same models."""
    digest = hashlib.sha256()

    def feed(value: Any) -> None:
        if isinstance(value, np.ndarray):
            digest.update(np.ascontiguousarray(value).tobytes())
        elif dataclasses.is_dataclass(value):
            feed([getattr(value, each.name) for each in dataclasses.fields(value)])
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


def save_model(model: LimbModel, path: Path) -> None:
    """Write a model; `load_model` restores it bit by bit.

    Raises CaseError if `info` or another free-form field contains something that is not plain data (numbers,
    text, arrays, tuples, lists, mappings with text keys).
    """
    arrays: dict[str, NDArray[Any]] = {}
    try:
        text = json.dumps({"format": FORMAT, "model": _encode(model, arrays)})
    except TypeError as error:
        raise CaseError(
            f"the model cannot be stored: {error}", where=str(path), fix="keep only plain data in `info`"
        ) from error
    arrays[_TEXT] = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    with atomic_file(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def load_model(path: Path) -> LimbModel:
    """Read a model written by `save_model`.

    Raises CaseError if the file is missing, corrupt, or of a newer format.
    """
    if not path.is_file():
        raise CaseError(
            f"the model {path.name} is missing", where=str(path.parent), fix="run `limbcli mesh CASE` first"
        )
    try:
        arrays = read_npz(path, budget=UnpackingBudget(_LARGEST))
        described = json.loads(arrays.pop(_TEXT).tobytes().decode("utf-8"))
        if described["format"] != FORMAT:
            raise ValueError(f"format {described['format']} where {FORMAT} was expected")
        found = _decode(described["model"], arrays)
        if not isinstance(found, LimbModel):
            raise ValueError("it contains no model")
        return found
    except _DAMAGED as error:
        raise CaseError(
            f"the stored model cannot be read ({error})", where=str(path), fix="run `limbcli mesh CASE` again"
        ) from error


def differences(a: object, b: object, path: str = "model") -> list[str]:
    """Differences between two models (or parts of them), exact in every bit and type.

    >>> differences(nouns.Curve(((0.0, 0.0),)), nouns.Curve(((0.0, 1.0),)), "curve")
    ['curve.points[0][1]: 0.0 and 1.0']
    """
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        same = isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.dtype == b.dtype
        return [] if same and np.array_equal(a, b) else [path]  # type: ignore[arg-type]
    if type(a) is not type(b):
        return [f"{path}: {type(a).__name__} and {type(b).__name__}"]
    if dataclasses.is_dataclass(a):
        names = [each.name for each in dataclasses.fields(a)]
        return [d for n in names for d in differences(getattr(a, n), getattr(b, n), f"{path}.{n}")]
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        if list(a) != list(b):
            return [f"{path}: keys {list(a)} and {list(b)}"]
        return [d for key in a for d in differences(a[key], b[key], f"{path}[{key}]")]
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        if len(a) != len(b):
            return [f"{path}: {len(a)} and {len(b)} items"]
        pairs = enumerate(zip(a, b, strict=True))
        return [d for i, (x, y) in pairs for d in differences(x, y, f"{path}[{i}]")]
    return [] if a == b else [f"{path}: {a!r} and {b!r}"]


def _encode(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """The value as plain JSON; arrays go to `arrays`, and types that JSON lacks are marked with `@`."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects")
        name = f"array_{len(arrays)}"
        arrays[name] = value
        return {"@array": name}
    if dataclasses.is_dataclass(value) and type(value).__name__ in _TYPES:
        fields = {each.name: getattr(value, each.name) for each in dataclasses.fields(value)}
        return {"@type": type(value).__name__, **{key: _encode(each, arrays) for key, each in fields.items()}}
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a mapping whose keys are not text")
        return {"@map": {key: _encode(each, arrays) for key, each in value.items()}}
    if isinstance(value, tuple):
        return {"@tuple": [_encode(each, arrays) for each in value]}
    if isinstance(value, list):
        return [_encode(each, arrays) for each in value]
    if isinstance(value, np.generic):
        return _encode(value.item(), arrays)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a {type(value).__name__}")


def _decode(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if isinstance(value, list):
        return [_decode(each, arrays) for each in value]
    if not isinstance(value, dict):
        return value
    if "@array" in value:
        return arrays[value["@array"]]
    if "@map" in value:
        return {key: _decode(each, arrays) for key, each in value["@map"].items()}
    if "@tuple" in value:
        return tuple(_decode(each, arrays) for each in value["@tuple"])
    kind = _TYPES[value["@type"]]
    return kind(**{key: _decode(each, arrays) for key, each in value.items() if key != "@type"})
