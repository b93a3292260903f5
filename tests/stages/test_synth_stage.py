"""Simulated measurements on a case's geometry, and the truth in them."""

from __future__ import annotations

import contextlib
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError, LimbError
from limbcli.feb.read import read_feb
from limbcli.files.atomic import atomic_folder
from limbcli.measurement.elastography import read_maps
from limbcli.measurement.indentation import read_levels
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.solvers.session import ReferenceSession
from limbcli.stages import synth as synth_module
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.phantom import PhantomOptions, phantom
from limbcli.stages.segment import segment
from limbcli.stages.simulated_subjects.indent import KnownTissue, depths_to
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.synth import synth, truth_file
from tests.stages.coarse_surfaces import coarse_surfaces

TISSUE = KnownTissue(c_kpa=6.0, f_kappa=20.0, m=6.0)
EXACT = SynthOptions(
    tissue=TISSUE,
    noise=0.0,
    same_mesh=True,
    element="tet4",
    protocol=LoadingProtocol(max_force=10.0, hold=1.0),
)


@pytest.fixture(scope="module")
def limb(tmp_path_factory):
    """A phantom without measurements, segmented and meshed coarsely (tet4)."""
    folder = tmp_path_factory.mktemp("synth")
    options = PhantomOptions(voxel=(2.0, 2.0, 5.0), synth=None, site_names=("p1",), element="tet4")
    phantom(folder / "limb", options=options)
    case = Case.open(folder / "limb")
    with pytest.MonkeyPatch.context() as patch:
        coarse_surfaces(patch)
        segment(case, out=folder / "out")
    mesh(case, out=folder / "out", options=MeshRequest(size=5.0, far_size=12.0))
    return folder


@pytest.fixture(scope="module")
def exact(limb):
    """Noise-free measurements on the very mesh."""
    case = Case.open(limb / "limb")
    return synth(case, out=limb / "out", out_case=limb / "exact", options=EXACT).folder


def test_depths_begin_closely_and_end_where_asked():
    assert depths_to(3.0, 1.0) == [0.25, 0.5, 1.0, 2.0, 3.0]
    assert depths_to(7.0, 1.0)[:5] == depths_to(10.0, 1.0)[:5]
    assert np.all(np.diff(depths_to(6.1, 1.0)) > 0)


@pytest.mark.slow
def test_levels_are_the_force_steps_and_speeds_start_at_the_ground_modulus(exact):
    levels = read_levels(exact / "p1" / "levels.csv")
    assert levels.force == pytest.approx(2.0 * np.arange(6), abs=1e-9)
    assert np.all(np.diff(levels.depth) > 0)
    assert levels.swe_mean_m_per_s[0] == pytest.approx(np.sqrt(3.0), rel=1e-4)
    assert np.all(np.diff(levels.swe_mean_m_per_s) > 0.02)
    maps = read_maps(exact / "p1" / "swe", len(levels))
    assert levels.swe_pixels.tolist() == [len(each) for each in maps]


@pytest.mark.slow
def test_truth_lies_beside_the_new_case_and_not_in_it(exact):
    truth = tomllib.loads(truth_file(exact).read_text())
    assert truth["tissue"] == {"c_kpa": 6.0, "f_kappa": 20.0, "m": 6.0}
    assert truth["site"][0]["force_n"][-1] == 10.0
    assert not list(exact.rglob("*truth*"))
    assert Case.open(exact).sites[0].noise.depth == 0.0


@pytest.mark.slow
def test_noise_free_levels_are_those_of_the_true_tissue_in_the_very_mesh(limb, exact):
    """What a fit has to find: at these depths the case's own model, with the truth, gives these forces."""
    case = Case.open(exact)
    out = limb / "again"
    shutil.copytree(limb / "out", out)
    built = build_feb(case, out=out, options=TissueOptions(f_kappa=TISSUE.f_kappa, m=TISSUE.m))[0]
    assert built.data["c_kpa"] == pytest.approx(6.0, rel=1e-4)
    with ReferenceSession(read_feb(built.path("feb"))) as session:
        forces = session.solve().must_points.forces
    np.testing.assert_allclose(forces, read_levels(exact / "p1" / "levels.csv").force[1:], rtol=5e-3)


@pytest.mark.slow
def test_only_what_synth_made_is_replaced(limb, exact, tmp_path):
    case = Case.open(limb / "limb")
    with pytest.raises(CaseError, match="is the case itself"):
        synth(case, out=limb / "out", out_case=limb / "limb", options=EXACT, force=True)
    with pytest.raises(CaseError, match="there already"):
        synth(case, out=limb / "out", out_case=exact, options=EXACT)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "levels.csv").write_text("force_n\n")
    with pytest.raises(CaseError, match="not made by synth"):
        synth(case, out=limb / "out", out_case=tmp_path / "mine", options=EXACT, force=True)


@pytest.mark.slow
def test_the_mesh_that_is_fitted_has_its_own_element_and_sizes(limb, tmp_path):
    case = Case.open(limb / "limb")
    for reported, words in (
        ({"size": 2.0}, "mesh sizes are given"),
        ({"element": "tet10"}, "is of tet4, not of tet10"),
    ):
        with pytest.raises(CaseError, match=words):
            synth(case, out=limb / "out", out_case=tmp_path / "new", options=replace(EXACT, **reported))
    assert not (tmp_path / "new").exists()


@pytest.fixture
def simulated(limb, tmp_path, monkeypatch):
    """A case, and the folder of one that was made of it, no site of which was measured."""
    monkeypatch.setattr(synth_module, "measure_sites", lambda *_, **__: [])
    case, folder = Case.open(limb / "limb"), tmp_path / "new"
    synth(case, out=limb / "out", out_case=folder, options=EXACT)
    return case, folder


@pytest.mark.slow
def test_what_is_expected_of_a_simulated_case_outlives_its_being_made_again(limb, simulated):
    case, folder = simulated
    (folder / "expected.toml").write_text("[site.p1]\n")
    synth(case, out=limb / "out", out_case=folder, options=EXACT, force=True)
    assert (folder / "expected.toml").read_text() == "[site.p1]\n"


@pytest.mark.slow
def test_a_case_whose_truth_cannot_be_written_does_not_replace_the_one_before(limb, simulated, monkeypatch):
    case, folder = simulated
    (folder / "mine").write_text("of the first")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(synth_module, "truth_table", full)
    with pytest.raises(LimbError):
        synth(case, out=limb / "out", out_case=folder, options=EXACT, force=True)
    assert (folder / "mine").exists()


@pytest.mark.slow
def test_a_kill_once_the_case_is_replaced_leaves_no_truth_of_the_one_before(limb, simulated, monkeypatch):
    case, folder = simulated
    again = {"out": limb / "out", "out_case": folder, "options": EXACT, "force": True}
    truth = truth_file(folder).read_text()

    @contextlib.contextmanager
    def killed(target):
        with atomic_folder(target) as work:
            yield work
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(synth_module, "atomic_folder", killed)
        with pytest.raises(KeyboardInterrupt):
            synth(case, **again)
    assert truth_file(folder).read_text() == ""
    synth(case, **again)
    assert truth_file(folder).read_text() == truth
