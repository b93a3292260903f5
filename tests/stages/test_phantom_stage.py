"""The phantom as a case folder: whole, valid, the same for the same seed, never over other data."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import typer

from limbcli.case import Case
from limbcli.cli.app import app
from limbcli.errors import CaseError
from limbcli.files.atomic import sha256
from limbcli.stages.phantom import PhantomOptions, phantom
from limbcli.stages.simulated_subjects.synth_options import SynthOptions

pytestmark = pytest.mark.slow

BARE = PhantomOptions(seed=3, voxel=(2.5, 2.5, 8.0), site_names=("p1", "p2"), synth=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("phantom") / "subject"
    phantom(target, options=BARE)
    return target


def test_the_folder_is_a_case_and_its_truth_is_beside(folder):
    case = Case.open(folder)
    assert [each.name for each in case.sites] == ["p1", "p2"]
    assert case.sites[0].marker == 1
    assert case.sites[1].position is not None
    assert len(list(case.imaging.mri.glob("*.dcm"))) > 15
    truth = tomllib.loads((folder / "truth" / "truth.toml").read_text())
    assert truth["seed"] == 3
    assert len(truth["marker"]) == 2
    names = {path.name for path in (folder / "truth").iterdir()}
    assert names == {"truth.toml", "labels.nii.gz", "skin.ply", "bone_tibia.ply", "bone_fibula.ply"}


def test_no_stage_could_read_the_truth_through_the_case(folder):
    assert "truth" not in (folder / "case.toml").read_text()


def test_the_first_marker_is_the_distal_one(folder):
    truth = tomllib.loads((folder / "truth" / "truth.toml").read_text())
    markers = np.array([each["position_mm"] for each in truth["marker"]])
    assert markers[0, 2] < markers[1, 2]
    place = np.array(truth["place"][0]["position_mm"])
    assert np.linalg.norm(markers[0] - place) < 4.0


def test_the_same_seed_gives_the_same_folder_another_seed_another(folder, tmp_path):
    phantom(tmp_path / "again", options=BARE)
    assert sha256(tmp_path / "again") == sha256(folder)
    other = PhantomOptions(seed=4, voxel=BARE.voxel, synth=None)
    reported = phantom(tmp_path / "other one", options=other).summary[-1]
    assert reported == f"next: limbcli segment '{tmp_path / 'other one'}'", "it can be pasted"
    assert sha256(tmp_path / "other one" / "mri") != sha256(folder / "mri")


def test_an_existing_folder_is_replaced_only_with_force_and_only_if_synthetic(folder, tmp_path):
    with pytest.raises(CaseError, match="there already"):
        phantom(folder, options=BARE)
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "case.toml").write_text("format = 1\n")
    with pytest.raises(CaseError, match="not a synthetic subject"):
        phantom(mine, options=BARE, force=True)
    assert (mine / "case.toml").read_text() == "format = 1\n"


def test_making_it_again_keeps_what_is_expected_of_it(tmp_path):
    phantom(tmp_path / "x", options=BARE)
    (tmp_path / "x" / "expected.toml").write_text("[site.p1]\n")
    (tmp_path / "x" / "stray.txt").write_text("old")
    phantom(tmp_path / "x", options=BARE, force=True)
    assert (tmp_path / "x" / "expected.toml").read_text() == "[site.p1]\n"
    assert not (tmp_path / "x" / "stray.txt").exists()


def test_an_unknown_site_is_named(tmp_path):
    with pytest.raises(CaseError, match="no site 'p9'"):
        phantom(tmp_path / "x", options=PhantomOptions(site_names=("p9",), synth=None))
    assert not (tmp_path / "x").exists()


def test_the_truth_is_measured_on_a_case_that_reaches_the_true_surfaces(tmp_path, monkeypatch):
    """They lie in the subject that is being made, outside that case's own folder."""
    seen = []

    def measured(case, sites, **_):
        assert case.imaging.skin.is_file()
        seen.extend(site.name for site in sites)
        return []

    monkeypatch.setattr("limbcli.stages.phantom.measure_sites", measured)
    phantom(tmp_path / "subject", options=replace(BARE, synth=SynthOptions()))
    assert seen == ["p1", "p2"]


@pytest.mark.slow
def test_what_is_hidden_is_measured_and_told_by_the_command(tmp_path, monkeypatch):
    seen = []

    def measured(case, sites, *, options, **_):
        seen.extend(each.facts() for each in options.hidden)
        return []

    monkeypatch.setattr("limbcli.stages.phantom.measure_sites", measured)
    main = typer.main.get_command(app)
    main(["phantom", str(tmp_path / "x"), "--effect", "skin-layer=4", "-q"], standalone_mode=False)
    thinner = np.log(1.0 + 1.25 * np.expm1(4.0))  # 1.2 mm with the stiffness along it of the 1.5 mm asked for
    assert [(each["effect"], each["skin_thickness_mm"]) for each in seen] == [("skin-layer", 1.2)]
    assert seen[0]["log_skin_ratio"] == pytest.approx(thinner)
