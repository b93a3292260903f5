"""Fibres in case.toml: what is told is kept, and what cannot be meant has a message of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.case.parts import Pennation
from limbcli.errors import CaseError
from tests.case.test_case_text import HEAD, LEVELS, SITE

AXIAL = '[[site.pennation]]\norientation = "axial"\npennation_deg = 12.0\n'
ACROSS = '[[site.pennation]]\norientation = "transverse"\npennation_deg = -4.0\ndeviation_deg = 2.0\n'
TURNED = SITE.format(name="p2", levels="p2.csv").replace('"transverse"', '"axial"')


def case(folder: Path, first: str, *, head: str = HEAD, second: str = TURNED) -> Path:
    (folder / "mri").mkdir()
    for name in ("p1", "p2"):
        (folder / f"{name}.csv").write_text(LEVELS)
    (folder / "case.toml").write_text(head + SITE.format(name="p1", levels="p1.csv") + first + second)
    return folder


def test_nothing_told_is_nothing_given(tmp_path: Path):
    assert not Case.open(case(tmp_path, "")).sites[0].fibres.given


def test_a_direction_and_angles_are_kept(tmp_path: Path):
    opened = Case.open(case(tmp_path, AXIAL + ACROSS, second=TURNED + "fibre_direction = [0.0, 0.2, 1.0]\n"))
    angles, reported = (each.fibres for each in opened.sites)
    assert angles.pennation == (Pennation("axial", 12.0, 5.0), Pennation("transverse", -4.0, 2.0))
    assert reported.direction == (0.0, 0.2, 1.0)
    assert reported.given


def test_an_orientation_may_be_a_site_at_the_same_place(tmp_path: Path):
    opened = Case.open(case(tmp_path, AXIAL.replace('"axial"', '"p2"')))
    assert opened.sites[0].fibres.pennation[0].orientation == "p2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fibre_direction = [0.0, 0.0, 0.0]\n", "fibre_direction has zero length"),
        ("fibre_direction = [0.0, 1.0]\n", "not three numbers"),
        ("fibre_direction = [0.0, nan, 1.0]\n", "not three numbers"),
        ("fibre_direction = [0.0, 0.0, 1.0]\n" + AXIAL, "both fibre_direction and"),
        (AXIAL + AXIAL, "in the image plane of 'axial' twice"),
        (AXIAL + AXIAL.replace('"axial"', '"p2"'), "in the same image plane, given twice"),
        (AXIAL + ACROSS + ACROSS.replace('"transverse"', '"p1"'), "in 3 image planes"),
        (AXIAL.replace('"axial"', '"p9"'), "the orientation 'p9' is not known"),
        (ACROSS, "only in an image across the limb"),
        (AXIAL.replace("12.0", "95.0"), "plausible values are -89 to 89 deg"),
        (AXIAL.replace("pennation_deg", "angle_deg"), "unknown key 'angle_deg'"),
        (AXIAL + ACROSS.replace("2.0", "0.0"), "plausible values are 0.1 to 45 deg"),
        ("pennation = 12.0\n", "not a list of tables"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_words(tmp_path: Path, text, message):
    with pytest.raises(CaseError, match=message) as caught:
        Case.open(case(tmp_path, text))
    assert "fix:" in str(caught.value)


def test_an_orientation_of_another_place_is_refused(tmp_path: Path):
    elsewhere = TURNED.replace("48.5", "40.0")
    with pytest.raises(CaseError, match="'p2' is that of another place"):
        Case.open(case(tmp_path, AXIAL.replace('"axial"', '"p2"'), second=elsewhere))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('fibres = "v1.nii.gz"\n', "names a file that was not found"),
        ('fibres = "mri"\n', "is not a file"),
        ('fibres = "p1.csv"\n', "is not a NIfTI file"),
        ('fibre_frame = "ras"\n', "fibre_frame but no `fibres`"),
        ('fibres = "p1.csv"\nfibre_frame = "mni"\n', "fibre_frame is 'mni'"),
    ],
)
def test_a_fibre_map_that_cannot_be_is_refused(tmp_path: Path, line, message):
    with pytest.raises(CaseError, match=message):
        Case.open(case(tmp_path, "", head=HEAD.replace('mri = "mri"\n', 'mri = "mri"\n' + line)))
