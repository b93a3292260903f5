"""Repeated loading: energy against closed forms, when a tissue repeats itself, and why it did not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError, MeasurementError
from limbcli.measurement.cycle_changes import change_text, changes, support_text
from limbcli.measurement.holds import cycles_of_holds
from limbcli.measurement.indentation import read_levels
from limbcli.measurement.levels import Levels
from limbcli.measurement.repeated_loading import Difference, compare, cycle_energy, study_cycles
from tests.measurement.repeated import FORCE, depth_of, repeated

NOISE = {"force_deviation": 0.1, "depth_deviation": 0.3}
HEADER = "cycle,phase,force_n,depth_mm\n"


def parallelogram() -> Levels:
    """Loading along (0,0) (2,2) (6,4), unloading along (4,4)(0,2) [force, depth]: area by hand."""
    force = np.array([0.0, 2.0, 6.0, 4.0, 0.0])
    depth = np.array([0.0, 2.0, 4.0, 4.0, 2.0])
    nan = np.full(5, np.nan)
    phase = ("load",) * 3 + ("unload",) * 2
    return Levels(
        force=force, depth=depth, swe_mean_m_per_s=nan, swe_sd_m_per_s=nan, swe_pixels=nan, phase=phase,
        hold=nan, probe_travel=nan, skin_bone=nan, path=Path("x.csv"),
    )  # fmt: skip


def test_energy_is_the_area_of_the_loop():
    found = cycle_energy(parallelogram(), 1, 0.1, 0.3)
    assert found is not None
    assert found.work == pytest.approx(2.0 + 8.0, abs=1e-12)
    assert found.lost == pytest.approx(10.0 - 4.0, abs=1e-12)
    assert found.share == pytest.approx(0.6)
    assert found.closed


def test_energy_of_a_loop_that_stays_open_is_that_above_its_last_level():
    levels = parallelogram()
    force = levels.force.copy()
    force[-1] = 2.0  # at 2 mm, where loading had 2 N too: from there on
    found = cycle_energy(replace(levels, force=force), 1, 0.1, 0.3)
    assert not found.closed
    assert found.work == pytest.approx(8.0, abs=1e-12)
    assert found.lost == pytest.approx(8.0 - 6.0, abs=1e-12)


def test_a_loop_is_closed_by_the_first_touch_of_the_next_cycle():
    """The parallelogram, whose last level stands as the second cycle's first."""
    closed, nan, n = parallelogram(), np.full(7, np.nan), 5
    force, depth = np.r_[closed.force, 2.0, 6.0], np.r_[closed.depth, 3.0, 4.5]
    phase, cycle = (*closed.phase[: n - 1], *("load",) * 3), np.array([1.0] * (n - 1) + [2.0] * 3)
    unread = dict.fromkeys(
        ("swe_mean_m_per_s", "swe_sd_m_per_s", "swe_pixels", "hold", "probe_travel", "skin_bone"), nan
    )
    levels = Levels(force=force, depth=depth, phase=phase, path=Path("x.csv"), cycle=cycle, **unread)
    found, alone = cycle_energy(levels, 1, 0.1, 0.3), cycle_energy(closed, 1, 0.1, 0.3)
    assert (found.work, found.lost, found.closed) == (alone.work, alone.lost, True)
    assert found.lost_deviation == pytest.approx(alone.lost_deviation)


def test_a_difference_is_largest_where_its_own_deviation_is_least():
    covariance = np.diag([1.0, 0.01, 0.25])
    three = np.arange(3.0)
    found = Difference(
        earlier=1, later=2, force=three, depth=np.array([2.0, -0.5, 1.0]), covariance=covariance, slope=three,
        earlier_depth=three,
    )  # fmt: skip
    assert found.largest == 1  # five deviations; two of the others


@pytest.mark.slow
def test_deviation_of_the_energy_is_that_of_repeated_readings():
    reported = cycle_energy(repeated({}), 1, 0.1, 0.3).lost_deviation
    losses = [cycle_energy(repeated({}, seed=k), 1, 0.1, 0.3).lost for k in range(300)]
    assert reported == pytest.approx(np.std(losses), rel=0.15)  # 300 draws know a deviation to 4 %


def test_equal_loadings_are_one_curve_at_the_stated_rate():
    """1 % of pairs are called different by noise alone; of 400, 4 expected."""
    p_values = []
    for seed in range(400):
        levels = repeated({}, {}, unload=False, seed=seed)
        p_values.append(compare(levels, 1, 2, 0.1, 0.3).p_value)
    assert (np.array(p_values) < 0.01).sum() <= 12
    assert 0.4 < np.mean(p_values) < 0.62, "neither too wide nor too narrow a covariance"


def test_the_cycle_from_which_the_tissue_repeats_itself_is_found():
    states = ({}, {"softer": 0.25}, {"softer": 0.4}, {"softer": 0.4})
    found = [study_cycles(repeated(*states, seed=k), **NOISE).repeats_from for k in range(20)]
    assert sum(each in (2, 3) for each in found) >= 18
    assert found.count(1) == 0


def test_tissue_that_still_changes_is_said_to():
    study = study_cycles(repeated({}, {"softer": 0.3}, {"softer": 0.8}, seed=7), **NOISE)
    assert study.repeats_from is None
    assert [each.earlier for each in study.contradicting(1)] == [1]
    assert not study.contradicting(3)


def test_one_loading_tells_nothing_of_repeats():
    study = study_cycles(repeated({}), **NOISE)
    assert study.repeats_from is None
    assert not study.differences
    assert set(study.energy) == {1}


@pytest.mark.parametrize(
    ("change", "name", "size"),
    [({"softer": 0.5}, "compliance", 0.5), ({"left": 2.0}, "residual depth", 2.0),
     ({"drift": 2.0}, "force offset", 2.0)],
)  # fmt: skip
def test_what_changed_is_told_apart_and_measured(change, name, size):
    hits, sizes = 0, []
    for seed in range(20):
        difference = compare(repeated({}, change, unload=False, seed=seed), 1, 2, 0.1, 0.3)
        best = changes(difference)[0]
        hits += best.name == name
        sizes.append(next(each.size for each in changes(difference) if each.name == name))
    assert hits >= 17
    assert np.mean(sizes) == pytest.approx(size, rel=0.2)  # first order in the offset


@pytest.mark.parametrize(
    ("change", "message"),
    [({"softer": 0.5}, "became softer by 50 %"), ({"softer": -0.3}, "became stiffer by 30 %"),
     ({"left": 2.0}, r"depths are 2 mm \(.*\) deeper"), ({"left": -2.0}, r"depths are 2 mm \(.*\) less deep"),
     ({"drift": 3.0}, r"cell reads .* N \(.*\) less"), ({"drift": -3.0}, r"cell reads .* N \(.*\) more")],
)  # fmt: skip
def test_words_say_which_way_it_went(change, message):
    reported = change_text(compare(repeated({}, change, unload=False), 1, 2, 0.1, 0.3))
    assert re.search(message, reported), reported


def test_words_name_the_cause_or_say_that_the_levels_do_not_tell():
    reported = change_text(compare(repeated({}, {"softer": 0.6}, unload=False, seed=7), 1, 2, 0.1, 0.3))
    assert "preconditioning" in reported
    same = change_text(compare(repeated({}, {}, unload=False, seed=7), 1, 2, 0.1, 0.3))
    assert "nothing changed beyond noise" in same
    slight = [
        change_text(compare(repeated({}, {"left": 0.9}, unload=False, seed=k), 1, 2, 0.1, 0.3))
        for k in range(10)
    ]
    assert any("cannot distinguish them" in each for each in slight)


def test_a_support_that_moved_shows_in_the_travel_only():
    moved = repeated({}, {"moved": 3.0}, unload=False, travel=True)
    reported = support_text(moved, study_cycles(moved, **NOISE), travel_deviation=0.3)
    assert reported.startswith("from cycle 1 to 2 the probe's travel grew by 3 mm more than the depth")
    assert reported.endswith("support moved")
    back = repeated({}, {}, {"moved": -3.0}, unload=False, travel=True)
    reported = support_text(back, study_cycles(back, **NOISE), travel_deviation=0.3)
    assert reported.startswith("from cycle 1 to 3 the probe's travel grew by 3 mm less than the depth")
    still = repeated({}, {}, unload=False, seed=7, travel=True)
    assert "did not move" in support_text(still, study_cycles(still, **NOISE), travel_deviation=0.3)
    silent = repeated({}, {}, unload=False, seed=7)
    assert support_text(silent, study_cycles(silent, **NOISE), travel_deviation=0.3) is None


def test_a_cycle_counts_its_depth_from_its_own_first_touch():
    levels = repeated({}, {"left": 0.8})
    second = levels.of_cycle(2)
    assert second.zero_depth == pytest.approx(0.8)
    np.testing.assert_allclose(second.depth[second.loading], depth_of(FORCE), atol=1e-12)
    assert second.rows[0] == (levels.cycle == 1).sum(), "its maps are those of its rows in the file"
    assert second.n_in_file == len(levels)


def test_a_cycle_that_begins_under_load_keeps_its_depths():
    levels = repeated({}, {"left": 0.8, "drift": -3.0})
    np.testing.assert_allclose(levels.of_cycle(2).depth[0], 0.8)


@pytest.mark.parametrize(
    ("requested", "message"),
    [("3", "there is no cycle 3"), ("0", "no cycle 0"), ("first", "no cycle first"), ("-1", "no cycle -1")],
)
def test_a_cycle_that_is_not_there_is_refused(requested, message):
    with pytest.raises(CaseError, match=message) as caught:
        repeated({}, {}).chosen_cycle(requested)
    assert "1, 2; or `last`" in caught.value.fix


def test_the_last_cycle_is_the_last_whole_one(tmp_path: Path):
    rows = "1,load,0,0\n1,load,2,1\n1,load,4,2\n1,unload,0,0.2\n2,load,0,0.3\n2,load,2,1.2\n"
    (tmp_path / "levels.csv").write_text(HEADER + rows)
    levels = read_levels(tmp_path / "levels.csv")
    assert levels.chosen_cycle() == 1
    with pytest.raises(CaseError, match="cycle 2 has 2 levels"):
        levels.chosen_cycle("2")


GOOD = ["1,load,0,0", "1,load,2,1", "1,load,4,2", "1,unload,2,1.3", "2,load,0,0.2", "2,load,2,1.1",
        "2,load,4,2"]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({4: "1,load,0,0.2"}, "loaded again within cycle 1"),
        ({4: "3,load,0,0.2", 5: "3,load,2,1.1", 6: "3,load,4,2"}, "cycle 2 is without a row"),
        ({0: "2,load,0,0"}, "the first row is of cycle 2"),
        ({1: "2,load,2,1", 2: "1,load,4,2"}, "out of order: cycle 1 comes after cycle 2"),
        ({1: "1.5,load,2,1"}, "cycle is 1.5"),
        ({1: "0,load,2,1"}, "cycle is 0"),
        ({1: ",load,2,1"}, "cycle is empty"),
        ({1: "1e30,load,2,1"}, "out of order"),
        ({3: "1,back,2,1.3"}, "phase is 'back'"),
        ({6: "2,load,0.5,2"}, "force decreases while the depth increases"),
    ],
)
def test_cycles_that_cannot_be_meant_are_refused_with_their_line(tmp_path: Path, change, message):
    rows = [change.get(k, row) for k, row in enumerate(GOOD)]
    path = tmp_path / "levels.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match=message) as caught:
        read_levels(path)
    assert "line" in str(caught.value)


def test_good_cycles_are_read(tmp_path: Path):
    (tmp_path / "levels.csv").write_text(HEADER + "\n".join(GOOD) + "\n")
    levels = read_levels(tmp_path / "levels.csv")
    assert levels.cycles == (1, 2)
    assert len(levels.of_cycle(1)) == 4


def test_holds_give_cycles_and_phases_where_the_force_turns():
    forces = [0.05, 2, 4.1, 6, 4, 2.05, 0.1, 2, 4, 6.1, 3, 0]
    cycle, phase = cycles_of_holds(forces, turn=1.0)
    assert cycle == [1] * 6 + [2] * 6
    assert phase == ["load"] * 4 + ["unload"] * 2 + ["load"] * 4 + ["unload"] * 2


def test_a_force_that_sags_in_one_hold_is_no_new_cycle():
    cycle, phase = cycles_of_holds([0, 2, 4, 3.4, 6, 8], turn=1.0)
    assert set(cycle) == {1}
    assert set(phase) == {"load"}
