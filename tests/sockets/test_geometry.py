"""The inner face is found, aligned, made from the skin, and refused with a reason of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stumps import DOWN, stump, wall

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.sockets.alignment import align, by_landmarks, mirror_image_warning
from limbcli.sockets.centre_line import centre_line, own_line
from limbcli.sockets.checks import check_around, check_near, check_openings, check_size, clearance
from limbcli.sockets.inner_face import inner_face
from limbcli.sockets.knee import check_knee
from limbcli.sockets.nearest import NearestPoints, on_triangles
from limbcli.sockets.rectification import CHOSEN, Rectification, along_curves, rectified

SKIN = stump()
LINE = centre_line(SKIN, DOWN)


def turned(degrees: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    a = np.radians(degrees)
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    transform[:3, 3] = shift
    return transform


def faces_limb(face: Triangles) -> float:
    inward = LINE.nearest(face.centroids) - face.centroids
    return float(face.areas[(face.area_vectors * inward).sum(axis=1) > 0].sum() / face.areas.sum())


@pytest.mark.parametrize("flip", [False, True])
def test_an_open_sheet_is_turned_towards_the_limb(flip: bool) -> None:
    sheet = stump(grow=-2.0, top=110.0)
    face = inner_face(sheet.flipped() if flip else sheet, LINE)
    assert len(face.faces) == len(sheet.faces)
    assert faces_limb(face) > 0.999


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("thickness", [3.0, 8.0])
def test_the_inner_side_of_a_wall_is_found(flip: bool, thickness: float) -> None:
    socket = wall(inner=-2.0, thickness=thickness)
    face = inner_face(socket.flipped() if flip else socket, LINE)
    expected = stump(grow=-2.0, top=110.0)
    assert face.areas.sum() == pytest.approx(expected.areas.sum(), rel=0.06)
    assert faces_limb(face) > 0.98
    away = np.linalg.norm(face.points - NearestPoints(expected).of(face.points)[0], axis=1)
    assert np.quantile(away, 0.95) < 0.1


def test_a_socket_shows_its_own_tip_in_its_own_frame() -> None:
    away = np.array([[1.0, 0, 0, 7.0], [0, 0, -1.0, 9.0], [0, 1.0, 0, -400.0], [0, 0, 0, 1.0]])
    for socket in (wall(), stump(top=110.0)):
        np.testing.assert_allclose(own_line(socket).along, DOWN, atol=0.1)
        np.testing.assert_allclose(own_line(socket.moved(away)).along, away[:3, :3] @ DOWN, atol=0.1)
    with pytest.raises(MeshError, match="where the limb enters"):
        own_line(SKIN.part(SKIN.centroids[:, 2] > 30.0))


@pytest.mark.slow
def test_a_transfemoral_socket_is_found_and_aligned_with_its_stump(shared: Path) -> None:
    folder = shared / "data" / "limb-scans" / "socket-sense"
    limb, socket = read_surface(folder / "Stump.stl"), read_surface(folder / "Socket.stl")
    face = inner_face(socket, own_line(socket))
    assert 0.4 < face.areas.sum() / socket.areas.sum() < 0.5  # a thin wall has two equal sides
    line = centre_line(limb, np.array([0.04, 0.26, 0.96]))
    found = align(face, limb, line)
    assert found.rms_mm < 5.0
    aligned = face.moved(found.transform)
    check_around(aligned, line)
    assert clearance(aligned, limb, line).deepest_mm < 5.0


def test_a_sheet_that_is_partly_inside_out_is_refused() -> None:
    sheet = stump(top=110.0)
    faces = sheet.faces.copy()
    half = sheet.centroids[:, 0] > 10.0
    faces[half] = faces[half][:, ::-1]
    with pytest.raises(MeshError, match="inside out"):
        inner_face(Triangles(sheet.points, faces), LINE)


@pytest.mark.parametrize(("scale", "unit"), [(1e-3, "units of m"), (1 / 25.4, "inch"), (0.1, "cm")])
def test_another_unit_is_named(scale: float, unit: str) -> None:
    socket = stump(top=110.0)
    with pytest.raises(MeshError, match=unit):
        check_size(Triangles(socket.points * scale, socket.faces), SKIN)
    check_size(socket, SKIN)


def test_a_socket_in_another_frame_is_refused() -> None:
    with pytest.raises(MeshError, match="apart"):
        check_near(stump().moved(turned(0.0, (400.0, 0.0, 0.0))), SKIN)
    check_near(stump(), SKIN)


def test_a_socket_that_does_not_surround_the_limb_is_refused() -> None:
    sheet = stump(top=110.0)
    check_around(sheet.flipped(), LINE)
    with pytest.raises(MeshError, match="does not surround"):
        check_around(sheet.part(sheet.centroids[:, 0] > 0.0), LINE)
    with pytest.raises(MeshError, match="of the limb's length"):
        check_around(sheet.part(sheet.centroids[:, 2] < 10.0), LINE)


def test_a_socket_that_opens_at_the_wrong_end_or_twice_is_refused() -> None:
    sheet = stump(top=110.0)
    check_openings(sheet.flipped(), LINE)
    upside_down = Triangles(sheet.points * [1.0, 1.0, -1.0] + [0.0, 0.0, 110.0], sheet.faces)
    with pytest.raises(MeshError, match="opens at the limb's distal end"):
        check_openings(upside_down, LINE)
    with pytest.raises(MeshError, match=r"a hole .* a valve's may have \d+ mm"):
        check_openings(sheet.part(sheet.centroids[:, 2] > 20.0).flipped(), LINE)


@pytest.mark.parametrize(
    ("centre", "words"),
    [
        ((90.0, 0.0, 140.0), "beside the limb's middle"),
        ((0.0, 0.0, -40.0), "below the limb's distal end"),
        ((0.0, 0.0, 600.0), "above the proximal cut"),
    ],
)
def test_a_knee_centre_outside_the_limb_is_refused(centre: tuple[float, float, float], words: str) -> None:
    check_knee(np.array([5.0, 5.0, 190.0]), LINE)  # images may end below the knee
    with pytest.raises(CaseError, match=words) as caught:
        check_knee(np.array(centre), LINE)
    assert "patient LPS" in caught.value.fix


def test_skin_above_a_brim_of_uneven_height_lies_neither_inside_nor_outside_the_wall() -> None:
    whole = stump(grow=1.0).flipped()
    trimmed = whole.part(whole.centroids[:, 2] < 80.0 + 0.7 * whole.centroids[:, 0])
    found = clearance(trimmed, SKIN, LINE)
    assert found.deepest_mm == 0.0
    assert found.widest_mm < 2.0


def test_clearance_is_positive_where_there_is_room() -> None:
    loose = clearance(stump(grow=3.0, top=110.0).flipped(), SKIN, LINE)
    tight = clearance(stump(grow=-3.0, top=110.0).flipped(), SKIN, LINE)
    # 3 mm across the axis are less along the normals, since the limb is tapered
    assert 2.3 < np.median(loose.distances) < 3.0
    assert -3.0 < np.median(tight.distances) < -2.3
    assert tight.deepest_mm < 4.0
    assert loose.deepest_mm < 0.5


def test_a_wall_deep_in_the_limb_is_refused() -> None:
    with pytest.raises(MeshError, match="inside the limb"):
        clearance(stump(grow=-30.0, top=110.0).flipped(), SKIN, LINE)


def test_landmarks_restore_a_pose_and_state_what_is_left() -> None:
    limb = np.array([[50.0, 0, 90], [0, 55.0, 60], [-40.0, 10, 30], [5.0, 5, 0]])
    pose = turned(130.0, (30.0, -200.0, 12.0))
    socket = limb @ np.linalg.inv(pose)[:3, :3].T + np.linalg.inv(pose)[:3, 3]
    found = by_landmarks(socket, limb)
    np.testing.assert_allclose(found.transform, pose, atol=1e-9)
    assert found.rms_mm < 1e-9
    assert found.turned_deg == pytest.approx(130.0)
    socket[0] += (4.0, 0.0, 0.0)
    assert 0.5 < by_landmarks(socket, limb).rms_mm < 4.0


@pytest.mark.parametrize(
    ("socket", "words"),
    [
        (np.zeros((2, 3)), "landmarks of the socket"),
        (np.array([[0.0, 0, 0], [0, 0, 10], [0, 0, 30]]), "within"),
        (np.array([[0.0, 0, 0], [0, 80, 10], [90.0, 0, 30]]), "off after"),
    ],
)
def test_bad_landmarks_have_their_own_messages(socket: np.ndarray, words: str) -> None:
    limb = np.array([[0.0, 0, 0], [0, 30, 10], [20.0, 0, 30]])
    with pytest.raises(MeshError, match=words):
        by_landmarks(socket, limb)


def test_a_landmark_that_is_off_is_named() -> None:
    limb = np.array([[0.0, 0, 0], [0, 30, 10], [20.0, 0, 30]])
    socket = np.array([[0.0, 0, 0], [0, 30, 10], [90.0, 0, 30]])
    with pytest.raises(MeshError, match="landmark tibial_end lies"):
        by_landmarks(socket, limb, names=("distal_tip", "popliteal", "tibial_end"))


def test_three_landmarks_place_a_mirrored_socket_but_its_shape_tells() -> None:
    """A bump on the left of the limb, and a socket with its room on the right: both match three landmarks."""
    landmarks = np.array([[0.0, 50, 90], [0, -50, 60], [0.0, 0, 0]])
    surfaces = []
    for surface in (stump(), stump(grow=1.0, top=110.0).flipped()):
        x, y, z = surface.points.T
        bump = 12.0 * (x > 0) * np.exp(-(((z - 60.0) / 25.0) ** 2))
        surfaces.append(Triangles(np.column_stack([x + bump, y, z]), surface.faces))
    skin, face = surfaces
    mirrored = Triangles(face.points * [-1.0, 1.0, 1.0], face.faces).flipped()
    assert by_landmarks(landmarks, landmarks).rms_mm < 1e-9
    assert mirror_image_warning(face, skin, landmarks) == ""
    assert "mirror image lies nearer" in mirror_image_warning(mirrored, skin, landmarks)


@pytest.mark.slow
def test_a_turned_and_shifted_socket_is_brought_back() -> None:
    pose = turned(75.0, (20.0, 300.0, -60.0))
    face = stump(grow=-2.0, top=110.0).flipped()
    found = align(face.moved(np.linalg.inv(pose)), SKIN, LINE)
    back = found.transform @ np.linalg.inv(pose)
    assert np.degrees(np.arccos(0.5 * (np.trace(back[:3, :3]) - 1))) < 3.0
    assert found.rms_mm < 2.5
    assert "mm rms" in found.sentence


@pytest.mark.slow
@pytest.mark.parametrize("grow", [-0.15, 0.15])
def test_a_tight_socket_lands_lower_and_a_loose_one_higher_by_what_the_result_tells(grow: float) -> None:
    """Its wall is 0.15 mm off the skin, of which the taper makes a height."""
    found = align(stump(grow=grow, top=110.0).flipped(), SKIN, LINE)
    higher = found.transform[2, 3]
    assert found.height_mm is not None
    assert 0.3 < higher / np.sign(grow) / found.height_mm < 1.5
    assert "tells its height to" in found.sentence


@pytest.mark.slow
def test_a_round_socket_is_not_turned_at_random() -> None:
    limb = stump(oval=0.0, bump=0.0)
    with pytest.raises(MeshError, match="landmarks") as caught:
        align(stump(top=110.0, oval=0.0, bump=0.0).flipped(), limb, centre_line(limb, DOWN))
    assert "fit equally well" in caught.value.what


def patch(x: float) -> np.ndarray:
    return np.flatnonzero(np.linalg.norm(SKIN.points - np.array([x, 0.0, 60.0]), axis=1) < 15.0)


def test_rectifications_move_patches_smoothly() -> None:
    patches = {"front": patch(62.0), "back": patch(-62.0)}
    table = Rectification(patches_mm={"front": 4.0, "back": -2.0}, all_mm=1.0, brim_mm=-120.0)
    face = rectified(SKIN, patches, table, DOWN)
    assert faces_limb(face) > 0.99
    kept = SKIN.points[:, 2] <= 120.0 + 1e-9
    moved = -NearestPoints(face).clearances(SKIN.points)
    assert moved[patches["front"]].mean() == pytest.approx(5.0, abs=0.5)
    assert moved[patches["back"]].mean() == pytest.approx(-1.0, abs=0.3)
    far = kept & (np.abs(SKIN.points[:, 0]) < 10.0) & (SKIN.points[:, 2] > 50)
    assert moved[far].mean() == pytest.approx(1.0, abs=0.1)


def test_without_a_table_the_skin_is_the_socket_and_it_is_said() -> None:
    table = Rectification(patches_mm={})
    face = rectified(SKIN, {}, table, DOWN)
    np.testing.assert_allclose(face.points, SKIN.points)
    assert table.sentence == CHOSEN


def test_folds_and_unknown_patches_are_refused() -> None:
    patches = {"front": patch(62.0)}
    with pytest.raises(CaseError, match="no patch 'back'"):
        rectified(SKIN, patches, Rectification(patches_mm={"back": 1.0}), DOWN)
    with pytest.raises(MeshError, match="fold"):
        rectified(SKIN, patches, Rectification(patches_mm={}, all_mm=75.0), DOWN)


def test_the_wall_follows_the_curves_between_the_corners_of_a_facet() -> None:
    """Facets on a cylinder of 50 mm, 20 mm long: flat ones would lie 1 mm inside it."""

    def on_cylinder(plan):
        x, y = np.array(plan, float).T
        return np.stack([50 * np.sin(x / 50), y, 50 * np.cos(x / 50)], axis=1)

    plan = [[0, 0], [20, 0], [0, 20], [10, 0], [10, 10], [0, 10], [20, 20], [20, 10], [10, 20]]
    surface = along_curves(on_cylinder(plan), np.array([[0, 1, 2, 3, 4, 5], [6, 2, 1, 8, 4, 7]]))
    radius = np.hypot(surface.centroids[:, 0], surface.centroids[:, 2])
    assert np.abs(radius - 50).max() < 0.1
    assert len(surface.points) == 25, "what two facets share is one"
    assert (surface.area_vectors[:, 2] > 0).all()


def test_the_nearest_point_is_within_on_a_side_or_at_a_corner() -> None:
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    for point, expected in (
        ((0.5, 0.5, 3.0), (0.5, 0.5, 0.0)),
        ((1.0, -1.0, 0.0), (1.0, 0.0, 0.0)),
        ((2.0, 2.0, 1.0), (1.0, 1.0, 0.0)),
        ((-1.0, -1.0, 0.0), (0.0, 0.0, 0.0)),
    ):
        np.testing.assert_allclose(on_triangles(np.array(point), corners), expected, atol=1e-12)


def test_the_brim_is_flared_and_the_rest_is_not() -> None:
    skin = stump()
    plain = Rectification(patches_mm={}, all_mm=1.0, brim_mm=-100.0)
    flared = replace(plain, flare_mm=3.0, flare_width_mm=20.0)
    faces = [rectified(skin, {}, table, DOWN) for table in (plain, flared)]
    low = [face.points[face.points[:, 2] < 75.0] for face in faces]
    np.testing.assert_array_equal(*low)
    # above the brim the wall goes on for up to 10 mm and rolls outward with a radius of 6 mm
    used = np.unique(skin.faces[(skin.points[:, 2] <= 110.0)[skin.faces].all(axis=1)])
    z = skin.points[used, 2]
    assert z.max() > 105.0
    moved = np.linalg.norm(faces[1].points - skin.points[used], axis=1)[z > 100.0]
    np.testing.assert_allclose(moved, 3.0 + (z[z > 100.0] - 100.0) ** 2 / 12.0, rtol=1e-9)
