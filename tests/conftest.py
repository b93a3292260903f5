"""Fixtures that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


def shared_folder() -> Path | None:
    """The reference data beside the repository (or LIMBCLI_SHARED), if it is there."""
    named = os.environ.get("LIMBCLI_SHARED")
    folder = Path(named) if named else REPOSITORY.parent / "shared"
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def shared() -> Path:
    folder = shared_folder()
    if folder is None:
        pytest.skip("needs the reference data: set LIMBCLI_SHARED to the folder that holds it")
    return folder


@pytest.fixture(scope="session")
def golden(shared: Path) -> Path:
    return shared / "febio-golden"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
