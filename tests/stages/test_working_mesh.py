"""The working mesh of a diagnosis, kept beside what it was made of."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from limbcli.diagnosis import prepare
from limbcli.model.npz_file import save_model
from limbcli.progress import SILENT
from tests.diagnosis import reduced


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Makes the mesh of a size and returns its number of points, on a folder that `segment` has left."""
    (tmp_path / "segment").mkdir()
    (tmp_path / "segment" / "segment.json").write_text("{}")
    segmented = SimpleNamespace(folder=tmp_path / "segment", data={})
    monkeypatch.setattr(prepare, "read_result", lambda *given, **more: segmented)
    monkeypatch.setattr(prepare, "site_position", lambda *given: [0.0, 0.0, 0.0])
    monkeypatch.setattr(prepare, "read_limb", lambda given: None)

    def model_of(limb, place, axis, probe, options, name):
        layers = max(1, round(25 / options.sizes.under_probe))
        return SimpleNamespace(model=reduced.block_model(2, 2, layers))

    monkeypatch.setattr(prepare, "site_model", model_of)

    def make(size: float) -> int:
        mine = prepare.Preparation.__new__(prepare.Preparation)
        mine.out, mine.work, mine.size = tmp_path, tmp_path / "work", size
        mine.site = SimpleNamespace(name="p1", long_axis="axial")
        probe = SimpleNamespace(length=53.0, width=11.0, edge_radius=2.0)
        mine.case = SimpleNamespace(probe=probe, model=SimpleNamespace(margin=40.0))
        mine.mesh, mine.progress, mine.notes = prepare.WorkingMesh(), SILENT, prepare.Notes()
        return len(mine._working_mesh().mesh.points)

    return make


def test_a_mesh_that_was_being_kept_when_the_program_ended_is_not_taken_for_another(made, monkeypatch):
    coarse, fine = made(5.0), made(2.5)
    assert made(5.0) == coarse < fine

    def killed(model, path):
        save_model(model, path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(prepare, "save_model", killed)
        with pytest.raises(KeyboardInterrupt):
            made(3.5)
    assert made(5.0) == coarse
    assert coarse < made(3.5) < fine


def test_another_versions_mesh_is_made_anew(made, monkeypatch):
    made(5.0)
    anew = SimpleNamespace(model=reduced.block_model(2, 2, 3))
    monkeypatch.setattr(prepare, "site_model", lambda *given, **more: anew)
    assert made(5.0) != len(anew.model.mesh.points)
    monkeypatch.setattr(prepare, "__version__", "0.0.0")
    assert made(5.0) == len(anew.model.mesh.points)
