"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import numpy as np
import pytest

from tests.blank_pictures import leave_blank

REPOSITORY = Path(__file__).resolve().parents[1]
# Files whose one test takes half a minute and more: at the end of a run all would wait for it.
LONGEST = {"test_walkthrough.py", "test_notebook.py", "test_pages.py", "test_killed.py"}


# Python's own thresholds would look through the many thousand objects of tests and modules again and again.
gc.set_threshold(50_000, 20, 20)


def pytest_collection_finish() -> None:
    """What is there by now stays, so that it need not be looked through."""
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first; all others stay in their order."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


_pictures = pytest.MonkeyPatch()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Before any fixture of the test, also those of its module."""
    _pictures.undo()
    if item.get_closest_marker("drawn") is None:
        leave_blank(_pictures)


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
