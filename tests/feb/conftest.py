"""A small model file of our own, so that this room is tested without reference data."""

from __future__ import annotations

from pathlib import Path

import pytest

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"


@pytest.fixture
def data() -> Path:
    return DATA


@pytest.fixture
def punch() -> Path:
    """A block of 192 tet4 under a flat rigid probe, 2 mm deep."""
    return DATA / "punch.feb"
