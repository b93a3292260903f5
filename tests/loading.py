"""A file of Python as a module, wherever it is and however pytest was started."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType


def module_at(path: Path) -> ModuleType:
    """The module that a file holds, under a name of its own."""
    spec = importlib.util.spec_from_file_location(f"limbcli_test_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
