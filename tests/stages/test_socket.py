"""`limbcli socket`: its files, the balance of forces, and every socket that it refuses."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
from scipy.stats import chi2

import limbcli
from limbcli.case import Case
from limbcli.case.socket import KneeInput, LinerInput, SocketInput
from limbcli.errors import CaseError, MeshError, SolveError
from limbcli.feb.read import read_feb
from limbcli.meshing.elements import with_element
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import LimbModel, Mesh
from limbcli.model.bodies import Contact
from limbcli.model.npz_file import load_model
from limbcli.progress import SILENT
from limbcli.provenance.staleness import Chain
from limbcli.results import read_result
from limbcli.sockets.nearest import NearestPoints
from limbcli.stages.in_socket.intervals import drawn_values, pressure_intervals
from limbcli.stages.in_socket.limb_in_socket import put_together
from limbcli.stages.in_socket.patch_table import WHOLE, PatchPressure
from limbcli.stages.limb import LimbOptions, limb
from limbcli.stages.segment import segment
from limbcli.stages.socket import SocketOptions, for_febio_to_solve, socket
from tests.meshing.stump import quickly_meshed, stump
from tests.stages.test_limb import write_case

SOCKET = "[socket]\nloads_n = [60.0]\nall_mm = 0.5\nbrim_mm = 110.0\nfriction = 0.0\n"
QUICK = SocketOptions(donning_steps=3, load_steps=2, intervals=False)


@pytest.fixture(scope="module")
def limb_made(tmp_path_factory):
    """A case with a coarse limb in its output folder."""
    folder = tmp_path_factory.mktemp("socket")
    case = write_case(folder / "case", more=SOCKET)
    segment(case, out=folder / "out")
    with pytest.MonkeyPatch.context() as patch:
        quickly_meshed(patch)
        limb(case, out=folder / "out", options=LimbOptions(element="tet4", nodes=3_000, c_kpa=16.0))
    return case, folder / "out"


@pytest.fixture(scope="module")
def made(limb_made):
    case, out = limb_made
    return limbcli.socket(case.folder, out=out, donning_steps=3, load_steps=2, intervals=False)


def with_surface(surface: Triangles, path: Path, **more) -> SocketInput:
    meshio.Mesh(surface.points, [("triangle", surface.faces.astype(np.int32))]).write(path)
    usual = {
        "align": False, "landmarks": {}, "rectifications": {}, "all_mm": 0.0, "transition": 15.0,
        "brim": None, "flare": 0.0, "friction": 0.0, "friction_deviation": 0.1, "loads": (60.0,),
        "limb_nodes": 3_000,
    }  # fmt: skip
    return SocketInput(surface=path, **{**usual, **more})


def together(limb_made, surface: Triangles, path: Path, **more):
    writer = SimpleNamespace(warnings=[])
    model = load_model(limb_made[1] / "limb" / "model.npz")
    return put_together(model, with_surface(surface, path, **more), writer)


def sleeve(*, grow: float = 0.0, top: float = 110.0, bottom: float = 0.0) -> Triangles:
    """The stump of the tests' limb, larger by `grow`, between two heights (LPS z)."""
    skin = stump()["skin"]
    out = skin.points * [1 + grow / 40.0, 1 + grow / 40.0, 1.0] - [0.0, 0.0, grow]
    z = skin.centroids[:, 2]
    return Triangles(out, skin.faces).part((z < top) & (z > bottom))


@pytest.mark.drawn
@pytest.mark.slow
def test_the_forces_are_in_balance_and_the_patches_are_listed(made):
    donned, loaded = made.data["states"]
    assert loaded["force_on_socket_n"][2] == pytest.approx(60.0, rel=1e-4)
    assert f"moved {loaded['socket_shift_mm'][2]:.1f} mm up the limb" in str(made)  # pressed onto it
    assert max(donned["imbalance_n"], loaded["imbalance_n"]) < 1e-4 * 60.0
    with made.files["patches"].open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["patch"] for row in rows} >= {WHOLE, "tibial_end", "popliteal", "distal_end"}
    whole = [each for each in made.patches if each.patch == WHOLE]
    assert whole[1].contact_area_mm2 > 0
    # below the brim, on a limb 80 mm across, the pressure carries the load on its lower end
    assert 2.0 < whole[1].mean_kpa < 200.0
    assert all(each.mean_kpa <= each.p95_kpa + 1e-9 <= each.peak_kpa + 2e-9 for each in made.patches)


@pytest.mark.slow
def test_the_files_say_the_same(made):
    grid = meshio.read(made.files["vtu"])
    pressure = grid.point_data["pressure_kpa_load_60_n"]
    assert np.nanmax(pressure) > 0
    assert np.isnan(pressure).any(), "inside the limb there is no pressure on the skin"
    stored = load_model(made.files["vtu"].parents[1] / "limb" / "model.npz")
    np.testing.assert_allclose(grid.points[: len(stored.mesh.points)], stored.mesh.points, atol=1e-3)
    written = read_feb(made.files["feb"])
    assert [each.name for each in written.bodies][-1] == "socket"
    assert made.files["picture_load_60_n"].is_file()


def test_augmented_contact_with_friction_is_told_to_be_no_file_for_febio():
    def told(friction: float, *, augmented: bool) -> list[str]:
        contact = Contact("skin", "socket_face", friction=friction, augmented=augmented)
        return for_febio_to_solve(LimbModel(Mesh(np.zeros((0, 3)), ()), {}, (), contacts=(contact,)))

    assert "without --penetration-mm" in told(0.3, augmented=True)[0]
    assert told(0.0, augmented=True) == told(0.3, augmented=False) == []


@pytest.mark.slow
def test_a_liner_that_slides_leaves_its_pressures_on_the_skin(limb_made, tmp_path: Path):
    case, out = limb_made
    liner = {"thickness_mm": 3.0, "youngs_modulus_kpa": 300.0, "bonded": False, "friction": 0.1}
    lined = replace(
        case, raw={**case.raw, "socket": {**case.raw["socket"], "liner": liner, "loads_n": [30.0]}}
    )
    for name in ("segment", "limb"):
        shutil.copytree(out / name, tmp_path / name)
    options = replace(QUICK, penetration_mm=0.0)
    result = socket(lined, out=tmp_path, options=options)
    assert "slides on the skin" in result.data["socket"]
    assert any("skin and liner lie up to" in each for each in result.summary)
    assert result.data["pressed"] == "skin"
    assert max(each["share"] for each in result.data["balance"]) < 1e-4
    written = read_feb(result.path("feb"))
    socket_side, skin_side = written.contacts
    assert (socket_side.primary, socket_side.friction) == ("liner", 0.0)
    assert (skin_side.primary, skin_side.secondary, skin_side.friction) == ("skin", "liner_inside", 0.1)
    grid = meshio.read(result.path("vtu"))
    pressure, shear = (grid.point_data[f"{name}_kpa_load_30_n"] for name in ("pressure", "shear"))
    on_skin = np.unique(next(iter(written.mesh.surfaces["skin"].facets.values())))
    outside = np.unique(next(iter(written.mesh.surfaces["liner"].facets.values())))
    assert np.flatnonzero(~np.isnan(pressure)).tolist() == np.union1d(on_skin, outside).tolist()
    assert shear[on_skin].max() > 0.0
    assert shear[outside].max() == 0.0
    (whole,) = (each for each in result.data["patches"] if each["patch"] == WHOLE and each["load_n"] == 30.0)
    assert 0.1 < whole["mean_shear_kpa"] / (0.1 * whole["mean_kpa"]) <= 1.01
    assert 0.3 < whole["contact_area_mm2"] / whole["area_mm2"] < 1.0


@pytest.mark.slow
def test_a_changed_socket_makes_the_result_stale(limb_made, made, tmp_path: Path):
    case, out = limb_made
    found = read_result(out, "socket")
    assert Chain(case, out).broken(found) is None
    other = replace(case, raw={**case.raw, "socket": {**case.raw["socket"], "all_mm": 1.0}})
    broken = Chain(other, out).broken(found)
    assert broken is not None
    assert "socket" in broken.what


def test_a_case_without_a_socket_or_a_limb_says_so(tmp_path: Path):
    bare = write_case(tmp_path / "bare")
    with pytest.raises(CaseError, match="gives no socket"):
        socket(bare, out=tmp_path / "out", options=QUICK)
    case = write_case(tmp_path / "case", more=SOCKET)
    with pytest.raises(CaseError, match="no result of `limb`") as caught:
        socket(case, out=tmp_path / "out", options=QUICK)
    assert "limbcli limb" in caught.value.fix
    with pytest.raises(CaseError, match="needs no alignment"):
        socket(Case.open_images(case.folder), out=tmp_path / "out", options=replace(QUICK, align=True))


@pytest.mark.slow
def test_the_lip_above_a_brim_is_not_taken_for_a_socket_at_the_cut(limb_made, tmp_path: Path):
    model = load_model(limb_made[1] / "limb" / "model.npz")
    usual = replace(with_surface(stump()["skin"], tmp_path / "skin.ply"), surface=None, all_mm=0.5, flare=3.0)
    told = []
    for brim in (None, float(model.info["frame"]["length_mm"]) - 12.0):
        writer = SimpleNamespace(warnings=[])
        put_together(model, replace(usual, brim=brim), writer)
        told.append(any("of the proximal cut" in each for each in writer.warnings))
    assert told == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("liner", [None, LinerInput(thickness=3.0, youngs_modulus=0.3, poisson=0.45)])
def test_a_socket_of_the_skins_own_shape_does_not_press_on_its_curves(limb_made, tmp_path: Path, liner):
    model = with_element(load_model(limb_made[1] / "limb" / "model.npz"), "tet10")
    facets = model.mesh.surfaces["skin"].facets["tri6"]
    points, corners = model.mesh.points.copy(), facets[:, :3]
    skin = Triangles(points, corners)
    outward = skin.point_normals[corners] + skin.point_normals[np.roll(corners, -1, axis=1)]
    middles, which = np.unique(facets[:, 3:], return_index=True)
    points[middles] += 0.4 * outward.reshape(-1, 3)[which] / 2
    model = replace(model, mesh=replace(model.mesh, points=points))
    given = replace(with_surface(stump()["skin"], tmp_path / "skin.ply"), surface=None, liner=liner)
    found = put_together(model, given, SimpleNamespace(warnings=[]))
    outer = found.limb.mesh.surfaces[found.touching].facets["tri6"][:, 3:]
    middles = found.limb.mesh.points[np.unique(outer)]
    below = middles[middles[:, 2] < found.face.points[:, 2].max() - 15.0]
    assert np.abs(NearestPoints(found.face).clearances(below)).max() < 0.05
    assert found.fit.deepest_mm < 0.05


@pytest.mark.slow
def test_a_socket_around_the_limb_is_taken(limb_made, tmp_path: Path):
    found = together(limb_made, sleeve(grow=0.5), tmp_path / "socket.ply")
    inward = np.einsum("ij,ij->i", found.face.area_vectors, np.array([0.0, 0.0, 60.0]) - found.face.centroids)
    assert (inward > 0).mean() > 0.9
    assert found.fit.deepest_mm < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (Triangles(sleeve().points / 1000.0, sleeve().faces), "as if it were in units of m"),
        (Triangles(sleeve().points + np.array([300.0, 0.0, 0.0]), sleeve().faces), "different frames"),
        (sleeve(bottom=45.0), "the socket is open"),
        (sleeve(grow=-25.0), "inside the limb at"),
    ],
    ids=["metres", "frame", "open", "deep"],
)
def test_a_socket_that_cannot_be_this_limbs_has_its_own_message(limb_made, tmp_path, surface, words):
    with pytest.raises(MeshError, match=words) as caught:
        together(limb_made, surface, tmp_path / "socket.ply")
    assert caught.value.fix


@pytest.mark.slow
def test_half_a_socket_and_one_partly_inside_out_have_their_own_messages(limb_made, tmp_path: Path):
    whole = sleeve(grow=0.5)
    half = whole.part(whole.centroids[:, 0] > 0)
    with pytest.raises(MeshError, match=r"surround|open|away from the limb"):
        together(limb_made, half, tmp_path / "half.ply")
    faces = whole.faces.copy()
    turned = whole.centroids[:, 2] > 70
    faces[turned] = faces[turned][:, ::-1]
    with pytest.raises(MeshError, match="inside out"):
        together(limb_made, Triangles(whole.points, faces), tmp_path / "turned.ply")


@pytest.mark.slow
def test_a_liner_meets_the_socket_where_there_is_room_for_it(limb_made, tmp_path: Path):
    liner = LinerInput(thickness=3.0, youngs_modulus=0.3, poisson=0.45)
    found = together(limb_made, sleeve(grow=4.0), tmp_path / "wide.ply", liner=liner)
    assert found.touching == "liner"
    outer = next(iter(found.limb.mesh.surfaces["liner"].facets.values()))
    assert len(outer) == len(found.skin.faces)
    assert found.fit.widest_mm < 4.0, "of the liner's outside"
    with pytest.raises(MeshError, match="thicker than the gap"):
        together(limb_made, sleeve(grow=0.5), tmp_path / "narrow.ply", liner=replace(liner, thickness=6.0))


@pytest.mark.slow
def test_what_the_thigh_does_to_the_limb_acts_on_the_socket_the_other_way(limb_made, tmp_path: Path):
    given = KneeInput((0.0, 5.0, 140.0), anterior=30.0, lateral=7.0, about_anterior=0.0, about_lateral=2e3)
    found = together(limb_made, sleeve(grow=0.5), tmp_path / "socket.ply", knee=given)
    assert found.knee is not None
    # of a left limb lateral is the patient's left, +x; anterior is -y
    np.testing.assert_allclose(found.directions_in_lps(np.array(found.knee.force)), [-7, 30, 0], atol=2.0)
    np.testing.assert_allclose(found.directions_in_lps(np.array(found.knee.moment)), [-2e3, 0, 0], atol=200)
    np.testing.assert_allclose(found.in_lps(np.array([found.knee.centre]))[0], given.centre, atol=1e-6)


@pytest.mark.slow
def test_a_femur_in_another_frame_than_its_stump_is_refused(shared: Path, tmp_path: Path):
    """A thigh stump, its femur and its socket lie in three frames; alignment places the socket alone."""
    folder = shared / "data" / "limb-scans" / "socket-sense"
    files = {"skin": folder / "Stump.stl", "bone_femur": folder / "Femur.STL"}
    case = write_case(tmp_path / "case", {name: read_surface(path) for name, path in files.items()})
    with pytest.raises(CaseError, match="bone_femur lies outside the skin") as caught:
        segment(case, out=tmp_path / "out")
    assert "in one frame" in caught.value.fix


@pytest.mark.slow
def test_landmarks_that_the_limb_does_not_have_are_named(limb_made, tmp_path: Path):
    marks = {"tibial_end": (0.0, 0.0, 0.0), "knee": (0.0, 1.0, 0.0), "distal_tip": (1.0, 0.0, 0.0)}
    with pytest.raises(CaseError, match="no landmark 'knee'"):
        together(limb_made, sleeve(), tmp_path / "socket.ply", landmarks=marks)


def row(c: float, friction: float, shift: float = 0.0) -> PatchPressure:
    """A table of one row that is linear in ln c, friction and a shift of the socket."""
    mean = 40.0 + 10.0 * np.log(c) - 20.0 * (friction - 0.3) + 2.0 * shift
    return PatchPressure(
        load_n=400.0,
        patch=WHOLE,
        area_mm2=1.0,
        contact_area_mm2=1.0,
        mean_kpa=mean,
        p95_kpa=mean,
        peak_kpa=mean,
        mean_shear_kpa=1.0,
        peak_shear_kpa=1.0,
    )


def test_intervals_of_a_linear_table_are_those_of_its_draws(tmp_path: Path):
    """ln c has a deviation of 0.2, friction of 0.1 and m none: the mean pressure has one of 2.83 kPa."""
    rng = np.random.default_rng(11)  # another than that of the friction
    c = 8.0 * np.exp(0.2 * rng.standard_normal(400))
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},{each},3.0" for k, each in enumerate(c))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))
    drawn = drawn_values(tmp_path / "draws.csv", 0.3, 0.1)
    limb = _one_element(c=0.008)

    def solved(model, friction, pose):
        assert pose == (0.0, 0.0, 0.0, 0.0)
        return [row(model.materials["tissue"].parameters["c1"] / 0.004, friction)]

    found = pressure_intervals(limb, 0.3, [row(1.0, 0.3)], drawn, solved, SILENT)
    low, high = found.intervals[400.0, WHOLE, "mean_kpa"]
    assert (high - low) / 3.92 == pytest.approx(2.83, rel=0.1)
    assert found.error_fraction < 0.01
    assert found.shares[400.0]["c"] == pytest.approx(0.5, abs=0.1)
    assert found.n_solves == 3, "m does not vary: it needs no solve"


def test_a_socket_that_may_sit_elsewhere_has_its_share(tmp_path: Path):
    """Friction has a deviation of 2 kPa, the shift along one direction of 4: four fifths of the variance."""
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},8.0,3.0" for k in range(400))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))
    drawn = drawn_values(tmp_path / "draws.csv", 0.3, 0.1, shift_mm=2.0)

    def solved(_model, friction, pose):
        return [row(1.0, friction, pose[2])]

    found = pressure_intervals(_one_element(c=0.008), 0.3, [row(1.0, 0.3)], drawn, solved, SILENT)
    assert found.shares[400.0]["alignment"] == pytest.approx(0.8, abs=0.06)
    assert sum(found.shares[400.0].values()) == pytest.approx(1.0)
    assert found.n_solves == 6, "each shift on both sides"


def test_a_pressure_that_rises_on_either_side_has_its_interval(tmp_path: Path):
    """40 kPa + x^2, x normal with a deviation of 2 mm: of chi2 with one degree of freedom, four times.
    Where a solve far to one side has no equilibrium, a nearer one gives the same parabola."""
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},8.0,3.0" for k in range(4000))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))
    drawn = drawn_values(tmp_path / "draws.csv", 0.0, 0.0, shift_mm=2.0)

    def solved(_model, _friction, pose):
        if pose[2] > 3.0:
            raise SolveError("no equilibrium", where="test", fix="none")
        return [row(1.0, 0.3, 0.5 * pose[2] ** 2)]

    found = pressure_intervals(_one_element(c=0.008), 0.0, [row(1.0, 0.3)], drawn, solved, SILENT)
    low, high = found.intervals[400.0, WHOLE, "mean_kpa"]
    assert low == pytest.approx(40.0, abs=0.02)
    assert high == pytest.approx(40.0 + 4 * chi2.ppf(0.975, 1), rel=0.03)
    assert found.error_fraction < 1e-9


def test_where_one_side_has_no_equilibrium_the_other_gives_a_line_and_neither_no_interval(tmp_path: Path):
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},8.0,3.0" for k in range(50))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))
    drawn = drawn_values(tmp_path / "draws.csv", 0.0, 0.0, shift_mm=2.0)
    impossible = [lambda x: x > 0.5, lambda x: abs(x) > 0.5]

    def solved_where(fails):
        def solved(_model, _friction, pose):
            if fails(pose[2]):
                raise SolveError("no equilibrium", where="test", fix="none")
            return [row(1.0, 0.3, pose[2])]

        return pressure_intervals(_one_element(c=0.008), 0.0, [row(1.0, 0.3)], drawn, solved, SILENT)

    found = solved_where(impossible[0])
    low, high = found.intervals[400.0, WHOLE, "mean_kpa"]
    assert (low, high) == pytest.approx((40.0 - 1.96 * 4.0, 40.0 + 1.96 * 4.0), rel=0.03)
    assert found.one_sided == ("shift_across",)
    with pytest.raises(SolveError, match="no intervals"):
        solved_where(impossible[1])


@pytest.mark.parametrize(("together", "is_rough"), [(0.0, False), (60.0, True)])
def test_a_patch_that_is_no_sum_of_its_parts_is_told(tmp_path: Path, together: float, is_rough: bool):
    """Its pressure has the product of c and friction, which one solve for each does not see."""
    rng = np.random.default_rng(11)
    c = 8.0 * np.exp(0.2 * rng.standard_normal(400))
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},{each},3.0" for k, each in enumerate(c))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))

    def rows(c, friction):
        whole = row(c, friction)
        product = together * np.log(c) * (friction - 0.3) / 0.1
        return [whole, replace(whole, patch="popliteal", mean_kpa=whole.mean_kpa + product)]

    found = pressure_intervals(
        _one_element(c=0.008), 0.3, rows(1.0, 0.3), drawn_values(tmp_path / "draws.csv", 0.3, 0.1),
        lambda model, friction, _: rows(model.materials["tissue"].parameters["c1"] / 0.004, friction), SILENT,
    )  # fmt: skip
    assert [each[:2] for each in found.rough] == [(400.0, "popliteal")] * is_rough


def test_few_draws_of_the_limb_do_not_narrow_where_the_socket_may_sit(tmp_path: Path):
    lines = ["draw,c_mean_kpa,m_mean", *(f"{k},8.0,3.0" for k in range(50))]
    (tmp_path / "draws.csv").write_text("\n".join(lines))
    drawn = drawn_values(tmp_path / "draws.csv", 0.3, 0.1, tilt_deg=1.0, shift_mm=2.0)
    assert drawn[:, 2:].std(axis=0) == pytest.approx([0.1, 1.0, 1.0, 2.0, 2.0], rel=0.05)
    ends = np.percentile(drawn[:, 3:] / [1.0, 1.0, 2.0, 2.0], [2.5, 97.5], axis=0)
    assert ends == pytest.approx(np.outer([-1.96, 1.96], np.ones(4)), abs=0.2)


def _one_element(c: float):
    from limbcli.materials.ogden import ogden_type
    from limbcli.model import Block, Domain, LimbModel, Mesh

    mesh = Mesh(np.eye(4, 3), (Block("tissue", "tet4", np.array([[3, 0, 1, 2]])),))
    law = ogden_type(c=c, f_kappa=100.0, m=3.0)
    return LimbModel(mesh=mesh, materials={"tissue": law}, domains=(Domain("tissue", "tissue"),))
