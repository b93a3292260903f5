"""AOP files: both dialects, the STL of the same limb, and there and back."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from limbcli.case.parts import Imaging
from limbcli.errors import CaseError, MeshError
from limbcli.imaging.surface import read_surface
from limbcli.stages.segmenting.surfaces import frames_of
from limbcli.surface_formats.aop import aop_limb, read_aop_limb, write_aop
from limbcli.surface_formats.triangle_files import read_triangles

HEAD = "AAOP1\nAAOP1\nany words\nEND COMMENTS\nCYLINDRICAL\nLEFT\n1\nTIB \n2\n99\n0\n10\n99\n-90\n20\n"
BODY = "4\n90\n3\n0\n0\n10\n30\n" + "10\n20\n10\n20\n" * 3


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "mixed"])
def test_lines_may_end_in_any_way_and_steps_may_be_even(tmp_path, end: str):
    text = HEAD + BODY
    text = text.replace("\n", "\r").replace("\r", "\n", 1) if end == "mixed" else text.replace("\n", end)
    (tmp_path / "a.aop").write_bytes(text.encode())
    limb = read_aop_limb(tmp_path / "a.aop")
    assert limb.side == "left"
    assert limb.heights.tolist() == [0, 10, 30]
    np.testing.assert_allclose(
        limb.points[:4], [[0, -10, 0], [20, 0, 0], [0, 10, 0], [-20, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(limb.landmark_points["TIB"], [[0, -10, 10], [-20, 0, 20]], atol=1e-12)


def test_the_normals_point_outward(tmp_path):
    for body in (BODY, BODY.replace("0\n0\n10\n30", "0\n30\n10\n0"), BODY.replace("4\n90", "4\n-90")):
        (tmp_path / "a.aop").write_text(HEAD + body)
        points, faces = read_triangles(tmp_path / "a.aop")
        a, b, c = np.moveaxis(points[faces], 1, 0)
        outward = np.cross(b - a, c - a) * ((a + b + c) / 3 * [1, 1, 0])
        assert (outward.sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("AAOP1\nA", "AAOP2\nA", "does not begin with AAOP1"),
        ("END COMMENTS", "END", "END COMMENTS is missing"),
        ("CYLINDRICAL", "CARTESIAN", "only CYLINDRICAL"),
        ("LEFT", "BOTH", "its side is 'BOTH'"),
        ("1\nTIB", "-1\nTIB", "number of landmarks is -1"),
        ("4\n90", "4\n120", "span a whole turn"),
        ("10\n30\n", "10\n5\n", "not in order"),
        ("20\n10\n20\n10", "20\nten\n20\n10", "'ten' is not a number"),
        ("10\n20\n10\n20\n10", "10\n20\n10\n-20\n10", "radius is negative"),
    ],
)
def test_what_is_damaged_is_refused(tmp_path, old: str, new: str, what: str):
    text = HEAD + BODY
    assert old in text
    (tmp_path / "a.aop").write_text(text.replace(old, new, 1))
    with pytest.raises(CaseError, match=what):
        read_surface(tmp_path / "a.aop")


def test_a_file_that_ends_early_or_goes_on_is_refused(tmp_path):
    for text, what in ((HEAD + BODY[:-4], "ends before"), (HEAD + BODY + "7\n", "lines follow")):
        (tmp_path / "a.aop").write_text(text)
        with pytest.raises(CaseError, match=what):
            read_surface(tmp_path / "a.aop")


def scan(shared: Path, name: str) -> Path:
    path = shared / "data" / "limb-scans" / "ampscan" / name
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    return path


@pytest.mark.parametrize("name", ["stl_file", "stl_file_2"])
def test_an_aop_is_the_stl_that_it_was_made_from(shared, name: str):
    limb, stl = read_aop_limb(scan(shared, f"{name}.aop")), read_surface(scan(shared, f"{name}.stl"))
    a, b, c = np.moveaxis(stl.points[stl.faces], 1, 0)
    normals = np.zeros_like(stl.points)
    for corner in stl.faces.T:
        np.add.at(normals, corner, np.cross(b - a, c - a))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tree, points = cKDTree(stl.points), limb.points.reshape(*limb.radii.shape, 3)[5:-8].reshape(-1, 3)
    shift = np.array([7.19, -5.91, -210.07])  # ampscan stores no origin; its files stand on the ground
    for _ in range(20):  # what is left of a shift, by least squares
        near = tree.query(points + shift)[1]
        off = ((points + shift - stl.points[near]) * normals[near]).sum(axis=1)
        shift = shift - np.linalg.lstsq(normals[near], off, rcond=None)[0]
    assert np.median(np.abs(off)) < 0.4  # slices were tilted by up to 1.1 degrees when they were made
    assert np.quantile(np.abs(off), 0.95) < 1.5


def test_an_aop_of_clinical_software_keeps_side_and_landmarks(shared):
    limb = read_aop_limb(scan(shared, "Example.AOP"))
    assert limb.side == "right"
    assert {name: len(each) for name, each in limb.landmarks.items()} == {"TIB": 2, "MPT": 1, "TE": 1}
    assert limb.radii.shape == (68, 72)
    assert limb.heights[-1] == 201
    mpt = limb.landmark_points["MPT"][0]
    assert mpt[1] < -50  # the patellar tendon is in front
    assert abs(mpt[0]) < 2
    assert mpt[2] == 127.48


def test_there_and_back(tmp_path):
    angle, height = np.meshgrid(np.arange(0, 360, 5.0), np.linspace(0, 60, 21))
    radius = 40 + 5 * np.sin(np.deg2rad(angle)) + 0.2 * height
    rows = np.stack([radius * np.sin(np.deg2rad(angle)), -radius * np.cos(np.deg2rad(angle)), height], axis=2)
    here = (np.arange(20)[:, None] * 72 + np.arange(72)).ravel()
    after = (np.arange(20)[:, None] * 72 + (np.arange(72) + 1) % 72).ravel()
    faces = np.r_[np.c_[here, after, after + 72], np.c_[here, after + 72, here + 72]]
    points = rows.reshape(-1, 3) + np.array([100.0, -30, 500])
    mark = points[10 * 72 + 7]
    limb, axis = aop_limb(points, faces, side="left", landmarks={"tubercle": mark})
    write_aop(tmp_path / "a.aop", limb, comments=["made in a test"])
    back = read_aop_limb(tmp_path / "a.aop")
    assert back.side == "left"
    np.testing.assert_allclose(back.radii, limb.radii, atol=1e-6)
    np.testing.assert_allclose(back.landmark_points["tubercle"][0] + axis, mark, atol=0.1)
    near = cKDTree(points).query(back.points + axis)[0]
    assert near.max() < 3.5  # within a facet
    np.testing.assert_allclose(np.ptp(back.points[:, 0]) / 2, np.ptp(limb.points[:, 0]) / 2, atol=1e-5)
    for k in (0, len(limb.heights) // 2):  # the surface's own radii about the same axis
        own = points - axis
        level = own[np.abs(own[:, 2] - limb.heights[k]) < 1.6]
        assert np.hypot(*level[:, :2].T).min() - 1 < limb.radii[k].min()
        assert limb.radii[k].max() < np.hypot(*level[:, :2].T).max() + 1


def test_a_limb_that_lies_across_is_refused():
    points = np.array([[0.0, 0, 0], [100, 0, 0], [0, 10, 0], [0, 0, 10]])
    with pytest.raises(MeshError, match="slices of the limb"):
        aop_limb(points, np.array([[0, 1, 3]]))


def test_the_stl_of_a_limb_written_as_aop_is_that_limb(shared, tmp_path):
    stl = read_surface(scan(shared, "stl_file.stl"))
    limb, axis = aop_limb(stl.points, stl.faces)
    assert np.ptp(limb.heights) > 0.75 * np.ptp(stl.points[:, 2])  # its upper rim is uneven
    assert limb.heights[0] == 0
    assert axis[2] < stl.points[:, 2].min() + 5
    write_aop(tmp_path / "a.aop", limb)
    off = cKDTree(stl.points).query(read_aop_limb(tmp_path / "a.aop").points + axis)[0]
    assert np.quantile(off, 0.99) < 4.0  # points of triangles with edges of about 4 mm


def test_the_side_that_a_file_states_is_compared_with_the_case_s_and_landmarks_are_listed(tmp_path):
    path = tmp_path / "skin.aop"
    path.write_text(HEAD + BODY)
    imaging = Imaging(skin=path)
    lines, _ = frames_of(SimpleNamespace(imaging=imaging, limb="left"))  # type: ignore[arg-type]
    assert "TIB [0.0, -10.0, 10.0], TIB [-20.0" in lines[0]
    with pytest.raises(CaseError, match="states that it is the left limb"):
        frames_of(SimpleNamespace(imaging=imaging, limb="right"))  # type: ignore[arg-type]
