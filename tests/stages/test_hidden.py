"""Effects hidden in readings, by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from limbcli.effects.stiffness_places import layer_share
from limbcli.effects.tissue import TISSUE
from limbcli.errors import CaseError
from limbcli.measurement.elastography import SweMap
from limbcli.model import LimbModel, Material
from limbcli.phantom.case_folder import NoiseLaw
from limbcli.phantom.protocol import LoadingProtocol, TrueLevels
from limbcli.phantom.simulated_readings import Readings
from limbcli.stages.simulated_subjects.hidden_effects import (
    check_beside_layers,
    check_beside_numbers,
    hide,
    in_order,
)
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.simulated_subjects.synth_truth import SyntheticSite, summary_of, truth_table
from limbcli.stages.synth import read_off
from tests.diagnosis.reduced import block_model
from tests.effects.test_together import ground


def _true() -> TrueLevels:
    swe = SweMap(np.zeros(3), np.array([5.0, 13.5, 22.0]), np.full(3, 2.0))
    return TrueLevels(np.array([0.0, 2.0, 4.0]), np.array([0.0, 3.0, 5.0]), (swe,) * 3, 30.0)


def _trace() -> np.ndarray:
    """Three holds of 6 s with ramps of 1 s between, at 10 Hz: time, force, depth, accelerations."""
    at = np.array([0.0, 6.0, 7.0, 13.0, 14.0, 20.0])
    time = np.arange(0.0, 20.0, 0.1)
    force, depth = (np.interp(time, at, np.repeat(levels, 2)) for levels in (_true().force, _true().depth))
    return np.column_stack([time, force, depth, np.zeros((len(time), 3))])


def _readings() -> Readings:
    true = _true()
    layers = np.array([[1.5, 5.0]] * 3)
    return Readings(
        force=true.force,
        depth=true.depth,
        maps=true.maps,
        skin_bone=30.0 - true.depth,
        hold=6.0,
        trace=_trace(),
        layers=layers,
    )


def shown(text: str) -> Readings:
    hidden = hide(text)
    assert hidden.in_readings is not None
    return hidden.in_readings(_readings(), _true())


def test_force_and_depth_effects():
    assert shown("force-zero=1.5").force == pytest.approx([1.5, 3.5, 5.5])
    scaled = shown("depth-gain=1.05")
    assert scaled.depth == pytest.approx(np.array([0, 3, 5]) / 1.05)
    assert scaled.skin_bone == pytest.approx(np.array([30, 27, 25]) / 1.05)
    assert scaled.layers == pytest.approx(np.array([[1.5, 5.0]] * 3) / 1.05)
    late = shown("depth-zero=1.2")
    assert late.depth == pytest.approx([1.8, 3.8])
    assert late.force == pytest.approx([2.0, 4.0])


def test_a_support_that_gives_way_shows_in_the_travel_alone():
    found = shown("support-motion=0.1")
    assert found.travel == pytest.approx([0.0, 3.2, 5.4])
    assert found.depth == pytest.approx(_readings().depth)
    assert found.force == pytest.approx(_readings().force)


def test_the_travel_is_read_with_the_noise_of_its_seed_and_site_and_with_none_where_none_is_asked_for():
    def travel(seed: int, number: int, noise: float) -> np.ndarray:
        plan = SynthOptions(seed=seed, noise=noise, hidden=(hide("support-motion=0.1"),))
        found = read_off(_true(), NoiseLaw().times(noise), plan, number).travel
        assert found is not None
        return found

    several = [travel(seed, number, 1.0) for seed in (1, 2) for number in (0, 1)]
    assert len(np.unique(np.round(several, 6), axis=0)) == 4
    assert np.max(np.abs(np.array(several) - [0.0, 3.2, 5.4])) < 0.5
    assert travel(1, 0, 0.0) == pytest.approx([0.0, 3.2, 5.4])


def test_speed_effects():
    assert shown("swe-time-scale=0.64").maps[0].speed_m_per_s == pytest.approx([2.5] * 3)
    biased = shown("swe-depth-bias=0.02").maps[0].speed_m_per_s
    assert biased == pytest.approx([2 * 1.17, 2.0, 2 * 0.83])
    guided = shown("swe-guided-wave=1").maps
    assert guided[2].speed_m_per_s[0] > guided[0].speed_m_per_s[0] > 2.0


def test_relaxation_leaves_more_force_and_faster_waves():
    found = shown("viscoelasticity=0.3")
    assert found.force[0] == 0.0
    assert np.all(found.force[1:] > _true().force[1:])
    assert found.maps[0].speed_m_per_s == pytest.approx([2 * np.sqrt(1.3)] * 3)
    time, force = found.trace[:, 0], found.trace[:, 1]
    early, late = force[np.abs(time - 7.5).argmin()], force[np.abs(time - 12.9).argmin()]
    assert early > late > 2.0  # it falls while the depth is held
    assert found.trace[:, 2] == pytest.approx(_trace()[:, 2])
    assert late == pytest.approx(found.force[1], rel=0.02)  # as the level's own reading


def test_the_record_is_misread_as_the_levels_are():
    assert shown("force-zero=1.5").trace[:, 1] == pytest.approx(_trace()[:, 1] + 1.5)
    assert shown("depth-zero=1.2").trace[:, 2] == pytest.approx(_trace()[:, 2] - 1.2)
    assert shown("depth-gain=1.05").trace[:, 2] == pytest.approx(_trace()[:, 2] / 1.05)


@pytest.mark.parametrize("size", [0.7, 1.5])
def test_a_preload_is_of_the_size_that_was_asked_for(size):
    """The level nearest to it had been taken: none at all was hidden below half a step."""
    hidden = hide(f"preload={size}")
    forces = LoadingProtocol(max_force=6.0, first=hidden.preload).forces(reached=9.0)
    assert forces == pytest.approx([size, size + 2.0, size + 4.0])
    true = replace(_true(), force=forces, depth=np.array([1.0, 3.0, 5.0]))
    trace = _trace() + np.array([0.0, size, 1.0, 0.0, 0.0, 0.0])
    readings = replace(_readings(), force=true.force, depth=true.depth, trace=trace)
    assert hidden.in_readings is not None
    found = hidden.in_readings(readings, true)
    assert found.force == pytest.approx([0.0, 2.0, 4.0])
    assert found.depth == pytest.approx([0.0, 2.0, 4.0])
    assert found.trace[:, 1] == pytest.approx(_trace()[:, 1])


@pytest.mark.parametrize(
    "names", list(itertools.permutations(["viscoelasticity", "depth-zero=1.2", "force-gain=1.1"]))
)
def test_readings_are_distorted_alike_in_whatever_order_it_is_asked_for(names):
    """A level that the depth's zero leaves out is loaded all the same, and remembered by the tissue."""
    readings = replace(_readings(), layers=np.array([[2.0, 6.0]] * 3))
    for each in in_order([hide(name) for name in (*names, "support-motion", "force-zero=1")]):
        assert each.in_readings is not None
        readings = each.in_readings(readings, _true())
    alone = shown("viscoelasticity").force[1:]
    assert readings.force == pytest.approx(1.1 * alone + 1.0)
    assert readings.depth == pytest.approx([1.8, 3.8])
    assert readings.travel is not None
    assert readings.layers is not None
    assert len(readings.travel) == len(readings.layers) == 2


def test_the_truth_tells_which_of_its_levels_were_not_read():
    plan = SynthOptions(noise=0.0, hidden=(hide("depth-zero=1.2"),))
    readings = read_off(_true(), NoiseLaw().times(0.0), plan, 0)
    site = SyntheticSite(
        site="p1", true=_true(), readings=readings, law=NoiseLaw(), facts={"element": "tet4", "n_elements": 3}
    )
    (true,) = truth_table([site], plan)["site"]
    assert np.delete(true["force_n"], true["levels_not_read"]) == pytest.approx(readings.force)
    assert "p1: 2 levels" in summary_of(site)


def test_the_truth_tells_parameters_as_they_are_hidden_not_as_the_effects_own_model_has_them():
    """One relaxation time of two was told, a skin of 1.5 mm for one of 1.2, no exponent of the fibres."""
    names = ("viscoelasticity=0.3", "skin-layer=2.3", "anisotropy")
    relaxing, skin, fibres = truth_table([], SynthOptions(hidden=tuple(map(hide, names))))["hidden"]
    share, held = np.array(relaxing["share_of_relaxing"]) * relaxing["relaxing_share"], 6.0
    times = np.array(relaxing["relaxation_time_s"])
    left = 2.0 * times * -np.expm1(-1.0 / times) * np.exp(-held / times)  # of a step of 2 N in 1 s
    assert shown("viscoelasticity=0.3").force[1] == pytest.approx(2.0 + share @ left)
    model = block_model()
    reported = 1.0 + layer_share(model, skin["skin_thickness_mm"]) * np.expm1(skin["log_skin_ratio"])
    assert ground(hide("skin-layer=2.3").in_model(model)) == pytest.approx(ground(model) * reported)
    (law,) = [each for each in _materials(hide("anisotropy").in_model(model)) if "alpha" in each.parameters]
    assert law.parameters["alpha"] == fibres["fibre_exponent"]


def _materials(model: LimbModel) -> list[Material]:
    whole = model.materials[TISSUE]
    return [whole, *whole.parts]


def test_stiffer_and_softer_places_are_hidden_beside_any_other_effect():
    """A second pair of exponents took the mean of c for that of every cell, had the fat come before it."""
    alone = ground(hide("adipose-layer").in_model(block_model()))
    for names in itertools.permutations(["adipose-layer", "nonlinearity", "contraction"]):
        model = block_model()
        for each in in_order([hide(name) for name in names]):
            model = each.in_model(model)
        assert ground(model) == pytest.approx(alone)


def test_skin_and_fat_are_not_hidden_in_tissue_below_layers_of_its_mesh():
    """All cells of the tissue lie deeper than a skin of 1.2 mm: nothing would be hidden."""
    hidden = [hide("contraction"), hide("skin-layer")]
    check_beside_layers(hidden, ())
    check_beside_layers(hidden[:1], ("fat",))
    with pytest.raises(CaseError, match="skin-layer cannot be hidden where the mesh has separate fat"):
        check_beside_layers(hidden, ("fat",))


def test_another_thickness_is_not_hidden_in_a_limb_given_by_it():
    """`check` refused the case that was made: its layers are not the distance to the bone."""
    check_beside_numbers([hide("preload")])
    with pytest.raises(CaseError, match="in a limb given by numbers"):
        check_beside_numbers([hide("preload"), hide("thickness")])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("skin_layr", "there is no effect"),
        ("force-zero=9", "must be a number from -4 to 4"),
        ("force-zero=much", "must be a number"),
        ("poroelasticity", "known here: .*thickness, .*viscoelasticity, .*preload"),
    ],
)
def test_what_cannot_be_hidden_is_said(text, message):
    with pytest.raises(CaseError, match=f"(?s){message}") as caught:
        hide(text)
    assert caught.value.where == "--effect"
