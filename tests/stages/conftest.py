"""Fixtures that several tests of stages share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.stages.coarse_surfaces import coarse_surfaces


@pytest.fixture(scope="module")
def coarse() -> Iterator[None]:
    """Coarse surfaces in all tests of a module: `pytestmark = pytest.mark.usefixtures("coarse")`."""
    with pytest.MonkeyPatch.context() as patch:
        coarse_surfaces(patch)
        yield
