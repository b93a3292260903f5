"""Makes the surrogate importable, however pytest was started."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.loading import module_at


@pytest.fixture(scope="session")
def simulated() -> ModuleType:
    return module_at(Path(__file__).with_name("simulated.py"))
