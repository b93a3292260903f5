"""What a reader of images repaired is told, but it is no warning that later stages and pages repeat."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.imaging.dicom import Series
from limbcli.imaging.volume import Volume
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.stages import segment as module

TRIVIA, MATTERS = "every image has its own Frame of Reference UID; it was ignored", "two limbs are in view"


def test_repairs_of_a_reader_are_told_but_are_no_warnings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    series = Series(Volume(np.zeros((2, 2, 2)), np.eye(4)), notes=(TRIVIA,))
    monkeypatch.setattr(module, "read_image", lambda *_, **__: series)
    monkeypatch.setattr(module, "segment_limb", lambda *_, **__: SimpleNamespace(notes=(MATTERS,)))
    monkeypatch.setattr(module, "_write", lambda *_: None)
    (tmp_path / "mri").mkdir()
    case = SimpleNamespace(limb="left")
    options = SimpleNamespace(hints=lambda limb: None)
    with open_stage(tmp_path / "out", "segment", subject="S1") as writer:
        module._from_series(case, tmp_path / "mri", options, writer, SILENT)  # type: ignore[arg-type]
    assert TRIVIA in writer.result.summary
    assert writer.result.warnings == (MATTERS,)
