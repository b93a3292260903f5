"""What a reader of images repaired is told, but it is no warning that later stages and pages repeat."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import nibabel as nib
import numpy as np
import pytest

from limbcli.imaging.dicom import Series
from limbcli.imaging.volume import Volume
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.stages import segment as module
from limbcli.stages.check import _read_mri

TRIVIA, MATTERS = "every image has its own Frame of Reference UID; it was ignored", "two limbs are in view"


def test_repairs_of_a_reader_are_told_but_are_no_warnings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    series = Series(Volume(np.zeros((2, 2, 2)), np.diag([1.0, 1.0, 3.0, 1.0])), notes=(TRIVIA,))
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


@pytest.mark.parametrize(
    ("spacing", "origin", "is_told"), [(1.0, 0.0, True), (1.0, 0.5, False), (0.9, 0.0, False)]
)
def test_an_image_that_lost_its_geometry_is_told(tmp_path: Path, spacing, origin, is_told):
    """A limb's size in an array saved without its affine is that of its voxels."""
    affine = np.diag([spacing] * 3 + [1.0])
    affine[0, 3] = origin
    values = np.random.default_rng(7).normal(300.0, 50.0, (5, 6, 7)).astype(np.float32)
    nib.save(nib.Nifti1Image(values, affine), tmp_path / "mri.nii.gz")
    found = _read_mri(tmp_path / "mri.nii.gz")
    assert [each.severity for each in found] == ["warning"] * is_told
    assert ["lost the geometry" in each.what for each in found] == [True] * is_told
