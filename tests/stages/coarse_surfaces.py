"""Surfaces of few triangles, for tests that ask for no more: making the usual ones is most of `segment`."""

from __future__ import annotations

import pytest

from limbcli.stages import segment
from limbcli.stages.segmenting import assumed_geometry


def coarse_surfaces(patch: pytest.MonkeyPatch) -> None:
    """Segment with edges of 5 mm (skin) and 3 mm (bones) instead of 2 and 1.5."""
    for module in (segment, assumed_geometry):
        patch.setattr(module, "SKIN_EDGE", 5.0)
        patch.setattr(module, "BONE_EDGE", 3.0)
