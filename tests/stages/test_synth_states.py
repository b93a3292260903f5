"""Simulated measurements in several states: what is true of each, and that they are the curves of a fit.

`test_fit_states` finds the truth again from such curves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import limbcli
from limbcli.case import Case
from limbcli.case.parts import Stretch
from limbcli.errors import CaseError
from limbcli.measurement.indentation import read_levels
from limbcli.model.npz_file import load_model
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.results import open_stage
from limbcli.shear_waves.pixels import Window
from limbcli.stages.simulated_subjects.hidden_effects import hide
from limbcli.stages.simulated_subjects.indent import KnownTissue, Press, indent
from limbcli.stages.simulated_subjects.known_stretches import (
    KnownStretches,
    known_stretches,
    parse_stretches,
    true_states,
)
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.synth import synth, truth_file
from tests.stages import block_case as block
from tests.stages import state_case

WAY = state_case.WAY
TISSUE = KnownTissue(c_kpa=1e3 * state_case.C, f_kappa=state_case.SHAPE[0], m=state_case.SHAPE[1])
PROTOCOL = LoadingProtocol(step=1.0, max_force=5.0, max_strain=0.3)
OPTIONS = SynthOptions(
    tissue=TISSUE, same_mesh=True, protocol=PROTOCOL, stretches=KnownStretches(Stretch(around=0.95))
)
ANY = (np.arange(4.0), 0.6 * np.arange(4.0), np.full(4, 1.8))  # readings that synth replaces
ROWS = dict.fromkeys(state_case.TOLD, ANY)


def cased(root: Path, given=state_case.TOLD, *, more: str = "") -> Case:
    """A case with three states, its geometry a block that needs no imaging and no meshing."""
    case = state_case.make_case(root / "case", root / "out", ROWS, given, more=more)
    with open_stage(root / "out", "segment", subject="B1") as writer:
        writer.summary.append("a block")
    return case


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[limbcli.MadeCase, Path]:
    """Levels simulated on another mesh than that of the fit."""
    root = tmp_path_factory.mktemp("synth-states")
    case = cased(root)
    other = block.block_model(counts=state_case.OTHER_MESH)
    options = replace(OPTIONS, alter=lambda model: other)
    found = synth(case, out=root / "out", out_case=root / "new", options=options)
    return limbcli.MadeCase.of(found), root


@pytest.mark.slow
def test_every_state_has_its_levels_and_its_truth(measured):
    made, root = measured
    case = made.case
    assert [each.name for each in case.sites[0].states] == list(state_case.TOLD)
    truth = made.truth["site"][0]
    assert truth["unloaded_stretch_around"] == 0.95
    for state, reported in zip(case.sites[0].states, truth["state"], strict=True):
        assert state.levels == case.folder / "p1" / state.name / "levels.csv"
        assert state.stretch.around == state_case.TOLD[state.name]
        assert reported["stretch_around"] == pytest.approx(state_case.TOLD[state.name] / 0.95)
        assert reported["stretch_along"] == 1.0
        levels = read_levels(state.levels)
        assert levels.force[0] == levels.depth[0] == 0.0
        assert levels.force == pytest.approx(np.array(reported["force_n"]), abs=0.3)
        assert np.all(np.diff(reported["depth_mm"]) > 0)
    assert not list(case.folder.rglob("*truth*"))
    assert truth_file(case.folder) == root / "new.truth.toml"
    rows = made.rows()
    assert len(rows) == sum(len(each["force_n"]) for each in truth["state"])
    assert {row["state"] for row in rows} == set(state_case.TOLD)


@pytest.mark.slow
def test_levels_of_a_state_are_those_of_the_curve_that_is_fitted():
    """The same mesh by another way, with PCHIP between other depths: within 0.03 mm and 1 %."""
    made = state_case.curve(counts=(8, 6, 3))
    for stretch in (0.8, 1.15):
        depth, speed = state_case.true_levels(made, [stretch])
        found = indent(
            Press(meshed=block.block_model(), tissue=TISSUE, stretch=(1.0, stretch)),
            protocol=PROTOCOL,
            window=Window(pixel=2.0),
        )
        read = [float(each.speed_m_per_s.mean()) for each in found.maps]
        n = min(len(depth), len(found.depth))
        assert n >= 5
        np.testing.assert_allclose(found.depth[1:n], depth[1:n], atol=0.03)
        np.testing.assert_allclose(read[:n], speed[:n], rtol=0.01)
    made.close()


@pytest.mark.slow
def test_fibres_in_the_tissue_can_be_hidden_and_a_tilted_probe_cannot():
    plain, fibred = (
        indent(
            Press(meshed=block.block_model(), tissue=TISSUE, stretch=(1.1, 1.0), change=change),
            protocol=PROTOCOL,
        )
        for change in (None, hide("anisotropy").in_model)
    )
    assert fibred.depth[-1] < plain.depth[-1]  # pulled fibres bear load
    for name in ("tilt", "viscoelasticity", "friction"):
        change = hide(name).in_model
        if change is None:
            continue
        with pytest.raises(CaseError, match="only effects in the elastic law of its tissue can be hidden"):
            indent(
                Press(meshed=block.block_model(), tissue=TISSUE, stretch=(1.1, 1.0), change=change),
                protocol=PROTOCOL,
            )


def states_of(root: Path, given, known: KnownStretches, *, more: str = ""):
    return true_states(cased(root, given, more=more).sites[0], known)


def test_told_stretches_are_over_that_at_which_the_tissue_is_unloaded(tmp_path):
    reported = {"middle": 0.9, "bent": None, "straight": 1.1}
    known = known_stretches({}, {"bent": 0.8}, Stretch(around=0.95))
    found = states_of(tmp_path, reported, known)
    assert [each.around for each in found] == pytest.approx([0.9 / 0.95, 0.8, 1.1 / 0.95])
    assert [each.along for each in found] == [1.0, 1.0, 1.0]


def test_what_the_case_knows_as_unloaded_needs_no_option(tmp_path):
    found = states_of(tmp_path, state_case.TOLD, KnownStretches(), more="unloaded_stretch_around = 0.9\n")
    assert found[0].around == 1.0


@pytest.mark.parametrize(
    ("given", "known", "more", "what", "fix"),
    [
        (
            state_case.TOLD, KnownStretches(), "",
            "the stretch around the limb at which the tissue is unloaded must be given",
            "--unloaded-stretch-around",
        ),
        (
            {"middle": 0.9, "bent": None}, KnownStretches(), "",
            "does not give the state's stretch around the limb", "--stretch-around bent=1.0",
        ),
        (
            state_case.TOLD, known_stretches({}, {"bent": 0.8}, Stretch(around=0.95)), "",
            "gives stretch_around = 0.72 for the state, and --stretch-around gives it again", "unknown",
        ),
        (
            state_case.TOLD, KnownStretches(Stretch(around=0.95)), "unloaded_stretch_around = 0.9\n",
            "unloaded at a stretch of 0.9 around the limb, but --unloaded-stretch-around is 0.95", "remove "
            "one",
        ),
        (
            state_case.TOLD, KnownStretches(Stretch(around=0.6)), "",
            "state straight would stretch the tissue around the limb to 1.83 of its unloaded", "correct",
        ),
    ],
)  # fmt: skip
def test_a_stretch_that_is_not_known_or_told_twice_is_said(tmp_path, given, known, more, what, fix):
    with pytest.raises(CaseError) as caught:
        states_of(tmp_path, given, known, more=more)
    assert what in caught.value.what
    assert "site p1" in caught.value.where
    assert fix in caught.value.fix


@pytest.mark.parametrize("text", ["bent", "=0.8", "bent=far", "bent=3", "bent=nan"])
def test_a_stretch_of_the_command_line_names_its_state(text):
    with pytest.raises(CaseError, match="not a state's name and its stretch") as caught:
        parse_stretches([text], option="--stretch-along")
    assert caught.value.where == "--stretch-along"
    with pytest.raises(CaseError, match="gives state bent twice"):
        parse_stretches(["bent=0.8", "bent=0.9"], option="--stretch-along")


def test_states_that_no_site_has_are_named_before_anything_is_simulated(tmp_path):
    case = cased(tmp_path)
    wrong = replace(OPTIONS, stretches=known_stretches({"bnt": 0.8}, {}, Stretch(around=0.95)))
    with pytest.raises(CaseError, match="has a state 'bnt'") as caught:
        synth(case, out=tmp_path / "out", out_case=tmp_path / "new", options=wrong)
    assert "bent" in caught.value.fix
    plain = block.make_case(
        tmp_path / "plain", tmp_path / "o2", np.array([1.0, 2.0]), np.array([1.0, 2.5]), c=0.006, build=False
    )
    with pytest.raises(CaseError, match="no simulated site has states"):
        synth(plain, out=tmp_path / "o2", out_case=tmp_path / "new", options=OPTIONS)
    with pytest.raises(CaseError, match="layers are not read in the states"):
        synth(case, out=tmp_path / "out", out_case=tmp_path / "new", options=replace(OPTIONS, layers=True))
    assert not (tmp_path / "new").exists()
    assert load_model(tmp_path / "out" / "mesh" / "p1" / "model.npz").info is not None
