"""Makes the surrogate importable, however pytest was started."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def simulated() -> ModuleType:
    path = Path(__file__).with_name("simulated.py")
    spec = importlib.util.spec_from_file_location("limbcli_test_simulated", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
