"""The walkthrough, from DICOM slices to a diagnosis, as a reader runs it: coarse and quick, the same code."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from limbcli import DiagnosisResult, FitResult
from limbcli.files.atomic import sha256

WALKTHROUGH = Path(__file__).resolve().parents[2] / "docs" / "walkthrough.py"


@pytest.mark.slow
def test_the_walkthrough_goes_from_dicom_to_a_diagnosis_and_leaves_pictures(tmp_path: Path):
    command = [sys.executable, str(WALKTHROUGH), "--quick", "--out", "here"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1500)
    assert result.returncode == 0, result.stderr
    folder = tmp_path / "here"
    assert len(list((folder / "subject" / "mri").glob("*.dcm"))) > 20
    found = DiagnosisResult.read(folder / "results", "p1")
    assert "force-zero" in {row["name"] for row in found.rows()}, found.sentences
    assert f"{found.verdict}: {found.reason}" in result.stdout
    fitted = FitResult.read(folder / "results", "p1")
    assert all(each.words in result.stdout for each in fitted.parameters)
    (whole,) = re.findall(r"^last level: ([\d.]+) N", result.stdout, re.MULTILINE)
    (halved,) = re.findall(r"^with half of kappa': ([\d.]+) N", result.stdout, re.MULTILINE)
    assert 0 < float(halved) < float(whole)
    pictures = [folder / "walkthrough.png", *(folder / "results").rglob("*.png")]
    assert {"contact-sheet.png", "mesh.png", "force-depth.png", "fit.png", "gap.png"} <= {
        p.name for p in pictures
    }
    assert all(path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 5000 for path in pictures)
    assert len({sha256(path) for path in pictures}) > 8
    assert result.stderr == ""
