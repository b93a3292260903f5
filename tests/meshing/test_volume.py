"""The chain of ways to a volume mesh, and the process the mesher runs in."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from limbcli.errors import MeshError, ToolError
from limbcli.meshing import mesher_process
from limbcli.meshing import site_mesher as volume
from limbcli.meshing.distance import Field, Grid
from limbcli.meshing.domain import CUT, SKIN, TissueDomain
from limbcli.meshing.mending import Plane
from limbcli.meshing.mesher_process import in_process
from limbcli.meshing.probe import PlacedProbe, ProbeShape
from limbcli.meshing.quality import volumes
from limbcli.meshing.remesh import Boundary, Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import Triangles, join
from limbcli.meshing.tetrahedra import Tetrahedra

PROBE = ProbeShape(40.0, 14.0, 3.0)


@pytest.mark.slow
def test_mesher_refusing_a_surface_is_a_mesh_error(make_ball):
    crossing = join([make_ball((0, 0, 0), 10.0, n=8), make_ball((5, 0, 0), 10.0, n=8)])
    with pytest.raises(MeshError, match="tetgen rejected"):
        in_process("tetgen", crossing.points, crossing.faces, {}, time_limit_s=30)


def test_mesher_that_runs_on_or_dies_is_a_mesh_error(make_ball, monkeypatch, tmp_path):
    ball = make_ball((0, 0, 0), 10.0, n=6)
    with pytest.raises(MeshError, match="ran out of time"):
        in_process("tetgen", ball.points, ball.faces, {}, time_limit_s=0.01)
    monkeypatch.setattr(mesher_process.sys, "executable", "/bin/false")
    with pytest.raises(MeshError, match="crashed"):
        in_process("tetgen", ball.points, ball.faces, {}, time_limit_s=5)


@pytest.mark.slow
def test_mesher_that_was_killed_is_run_once_more(make_ball, monkeypatch, tmp_path):
    killer = "import os, pathlib, signal\ndef TetGen(*_):\n    pathlib.Path({!r}).open('a').write('x')\n"
    times = tmp_path / "times"
    (tmp_path / "tetgen.py").write_text(
        killer.format(str(times)) + "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ball = make_ball((0, 0, 0), 10.0, n=6)
    whole = in_process("tetgen", ball.points, ball.faces, {}, time_limit_s=60)
    environments = [{"PYTHONPATH": str(tmp_path)}, {}]
    ours = mesher_process._environment()
    monkeypatch.setattr(mesher_process, "_environment", lambda: {**ours, **environments.pop(0)})
    nodes, cells = in_process("tetgen", ball.points, ball.faces, {}, time_limit_s=60)
    assert times.read_text() == "x"
    assert np.array_equal(nodes, whole[0])
    assert np.array_equal(cells, whole[1])
    environments += 2 * [{"PYTHONPATH": str(tmp_path)}]
    with pytest.raises(MeshError, match="status -9"):
        in_process("tetgen", ball.points, ball.faces, {}, time_limit_s=60)
    assert times.read_text() == "xxx"


@pytest.mark.slow
def test_mesher_that_is_not_installed_is_a_tool_error(make_ball, monkeypatch, tmp_path):
    (tmp_path / "pytetwild.py").write_text("raise ImportError('not here')")
    monkeypatch.setattr(mesher_process, "_environment", lambda: {"PYTHONPATH": str(tmp_path)})
    ball = make_ball((0, 0, 0), 10.0, n=6)
    with pytest.raises(ToolError, match="not installed"):
        in_process("pytetwild", ball.points, ball.faces, {}, time_limit_s=60)


needs_ftetwild = pytest.mark.skipif(
    importlib.util.find_spec("pytetwild") is None, reason="the extra ftetwild is not installed"
)


@pytest.mark.slow
@needs_ftetwild
def test_ftetwild_fills_what_tetgen_refuses(make_ball):
    """Two balls that pierce each other: the volume of their union."""
    crossing = join([make_ball((0, 0, 0), 10.0, n=8), make_ball((5, 0, 0), 10.0, n=8)])
    with pytest.raises(MeshError, match="tetgen rejected"):
        in_process("tetgen", crossing.points, crossing.faces, {}, time_limit_s=30)
    options = {"edge_length_abs": 6.0, "epsilon": 0.01, "num_opt_iter": 2, "num_threads": 2}
    nodes, cells = in_process("pytetwild", crossing.points, crossing.faces, options, time_limit_s=120)
    lens = np.pi * 7.5**2 * (3 * 10 - 7.5) / 3 * 2  # of two caps of height R - d/2
    sphere = 4 / 3 * np.pi * 10**3
    union = (2 * sphere - lens) * make_ball((0, 0, 0), 10.0, n=8).volume / sphere
    assert np.abs(volumes(nodes, cells)).sum() == pytest.approx(union, rel=0.02)


@needs_ftetwild
@pytest.mark.slow
def test_site_whose_surface_tetgen_refuses_is_meshed_by_ftetwild(leg, monkeypatch):
    """One skin node pushed through the bone: TetGen refuses each way, the last of the chain does not."""
    remesh = volume.remesh

    def pierced(*arguments):
        made = remesh(*arguments)
        points = made.surface.points.copy()
        points[np.argmax(points[:, 2])] -= [0.0, 0.0, 40.0]
        return Boundary(Triangles(points, made.surface.faces), made.labels)

    monkeypatch.setattr(volume, "unfold", lambda graded, _domain: graded)
    monkeypatch.setattr(volume, "bad_places", lambda _graded: np.zeros((0, 3)))
    monkeypatch.setattr(volume, "remesh", pierced)
    monkeypatch.setattr(volume, "_remeshed_or_not", lambda d, f, _t: remesh(d.boundary, d, f).surface)
    sizes = Sizes(under_probe=5.0, far=12.0, growth=0.35, reach=2.0)  # refused all three ways
    options = MeshOptions(element="tet4", sizes=sizes, margin=15.0, spacing=2.0)
    found = site_model(leg, (0.0, -40.0, 0.0), "transverse", PROBE, options)
    assert found.maker == "fTetWild"
    refused = [each for each in found.notes if "tetgen rejected" in each or "TetGen" in each]
    assert len(refused) >= 3
    assert found.quality.min_angle_deg >= volume.MIN_ANGLE_DEG
    assert found.quality.min_angle_under_probe_deg >= volume.MIN_ANGLE_UNDER_PROBE_DEG
    assert found.quality.inverted_cells == 0
    skin = found.domain.skin.at(
        found.model.mesh.points[found.model.mesh.surfaces["contact"].facets["tri3"].ravel()]
    )
    assert np.abs(skin).max() < 0.5, "the skin is where it was"


def empty_domain() -> TissueDomain:
    return TissueDomain(None, None, (), ())  # type: ignore[arg-type]


def test_every_way_is_tried_and_told(monkeypatch):
    def refuse(*_arguments):
        raise MeshError("refused", where="here", fix="none")

    monkeypatch.setattr(volume, "_with_tetgen", refuse)
    monkeypatch.setattr(volume, "_with_ftetwild", refuse)
    with pytest.raises(MeshError) as caught:
        volume.mesh_volume(empty_domain(), (PlacedProbe(PROBE),), Sizes())
    for name in ("as asked", "remeshed finer", "bones smoothed", "fTetWild"):
        assert f"{name}: refused" in caught.value.what


def test_poor_cells_lead_to_the_next_way(monkeypatch):
    flat = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [3, 3, 0.2]])
    good = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10.0]])
    calls = []

    def mesh(_domain, _probe, sizes, _tale):
        calls.append(sizes.under_probe)
        points = flat if len(calls) == 1 else good
        cells = np.array([[0, 1, 2, 3]])
        return volume.VolumeMesh(
            points, cells, volume.boundary_faces(cells), np.ones(4, np.int64), "TetGen", ()
        )

    monkeypatch.setattr(volume, "_with_tetgen", mesh)
    found = volume.mesh_volume(empty_domain(), (PlacedProbe(PROBE),), Sizes(2.0, 8.0))
    assert calls == [2.0, 1.5]
    assert "smallest dihedral angle only" in found.notes[0]


def test_turned_edges_on_a_cut_are_named_by_their_place():
    """A square cut face whose diagonal the mesher turned keeps the label of the cut."""
    square = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [5, 5, -8]])
    cells = np.array([[0, 1, 4, 2], [0, 2, 4, 3]])
    sides = [each for each in volume.boundary_faces(cells).tolist() if 4 in each]
    ours = np.array([[0, 1, 3], [1, 2, 3], *sides])
    grid = Grid(np.full(3, -20.0), 10.0, (5, 5, 5))
    far = Field(grid, np.full((5, 5, 5), -100.0))
    domain = TissueDomain(far, None, (Plane(np.array([0.0, 0, 1]), 0.0),), ())
    graded = Boundary(Triangles(square, ours), np.array([CUT, CUT, SKIN, SKIN, SKIN, SKIN]))
    faces, labels = volume.labelled_boundary(Tetrahedra(square, cells, "TetGen"), graded, domain)
    assert len(faces) == 6
    flat = (square[faces][:, :, 2] == 0).all(axis=1)
    assert (labels[flat] == CUT).all()
    assert flat.sum() == 2


def test_boundary_of_two_cells_is_six_outward_faces():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    faces = volume.boundary_faces(np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))
    assert len(faces) == 6
    a, b, c = (points[faces[:, k]] for k in range(3))
    outward = (a + b + c) / 3 - points.mean(axis=0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), outward) > 0).all()
