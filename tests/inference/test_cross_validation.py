"""Predictions of people left out: no way from a person's own readings to their prediction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limbcli.inference.cross_validation import (
    FOLDS,
    lines_left_out,
    mean_interval,
    percent_off,
    person_folds,
    predict_left_out,
    springs_left_out,
)


def cohort(rng, n=40, noise=0.1):
    people = np.repeat([f"P{k}" for k in range(n)], 2)
    sites = np.tile(["A", "B"], n)
    features = rng.normal(0, 0.4, (2 * n, 3))
    ln = 6.0 + (sites == "B") * 0.7 + features @ [0.5, 0.2, 0.0] + rng.normal(0, noise, 2 * n)
    return people, sites, features, np.exp(ln)


def no_slab(train):
    return np.zeros(len(train))


@settings(max_examples=25, deadline=None)
@given(st.integers(10, 60), st.integers(0, 1000))
def test_a_person_is_in_one_fold_and_folds_are_of_one_size(n, seed):
    people = np.repeat([f"P{k}" for k in range(n)], 3)
    fold = person_folds(people, FOLDS, seed)
    by_person = fold.reshape(n, 3)
    assert (by_person == by_person[:, :1]).all()
    counts = np.bincount(by_person[:, 0], minlength=FOLDS)
    assert counts.max() - counts.min() <= 1


def test_what_can_be_known_is_found(rng):
    people, sites, features, compliance = cohort(rng)
    found = predict_left_out(people, sites, features, compliance, no_slab)
    # Nothing can be better than the noise of 10 %, 8 % in the mean; a site's mean alone misses 20 %.
    assert percent_off(found.predicted, compliance).mean() < 10.5


def test_a_left_out_person_does_not_enter_their_own_prediction(rng):
    people, sites, features, compliance = cohort(rng, n=20)
    before = predict_left_out(people, sites, features, compliance, no_slab)
    fold = before.fold[0]
    out = before.fold == fold
    changed = np.where(out, compliance * np.exp(rng.normal(0, 1.0, len(compliance))), compliance)
    after = predict_left_out(people, sites, features, changed, no_slab)
    assert after.predicted[out] == pytest.approx(before.predicted[out], rel=1e-12)
    assert np.abs(after.predicted[~out] / before.predicted[~out] - 1).max() > 1e-3


def test_the_slab_is_asked_for_training_rows_only_once_a_fold(rng):
    people, sites, features, compliance = cohort(rng, n=12)
    calls = []
    predict_left_out(people, sites, features, compliance, lambda train: calls.append(train) or no_slab(train))
    assert len(calls) == FOLDS
    assert np.sum([~each for each in calls], axis=0).tolist() == [1] * len(people)


def test_springs_in_series_are_found_exactly(rng):
    people = np.array([f"P{k}" for k in range(30)])
    thickness = rng.uniform(2, 40, (30, 2))
    compliance = thickness @ [20.0, 12.0]
    assert springs_left_out(people, thickness, compliance) == pytest.approx(compliance)


def test_lines_are_those_of_each_site_and_of_other_people(rng):
    """Exact where there is no noise; a reading that is far off moves everybody's but its own person's."""
    people, sites = np.repeat([f"P{k}" for k in range(30)], 2), np.tile(["A", "B"], 30)
    thickness = rng.uniform(2, 40, (60, 2))
    compliance = np.where(sites == "A", 3.0 + thickness @ [20.0, 12.0], 9.0 + thickness @ [5.0, 8.0])
    assert lines_left_out(people, sites, thickness, compliance) == pytest.approx(compliance)
    off = compliance + 1000.0 * (np.arange(60) == 0)
    moved = np.abs(lines_left_out(people, sites, thickness, off) - compliance) > 1e-6
    fold = person_folds(people, FOLDS, 7)
    assert moved.tolist() == ((sites == "A") & (fold != fold[0])).tolist()


@pytest.mark.slow
def test_slopes_of_chance_are_shrunken_and_those_of_a_site_are_not(rng):
    """Chosen by people that were left out of the training, too: judged by themselves, the weakest shrinking
    is always the best."""
    people, sites = np.repeat([f"P{k}" for k in range(30)], 2), np.tile(["A", "B"], 30)
    features, noise = rng.normal(0, 1, (60, 8)), rng.normal(0, 0.3, 60)
    own = np.where(sites == "A", 1.0, -1.0) * (features @ np.linspace(0.2, 0.5, 8))
    for ln, chosen in ((noise, 60.0), (own + 0.1 * noise, 10.0)):
        found = predict_left_out(people, sites, features, np.exp(6.0 + ln), no_slab)
        assert [each["shrink_site"] for each in found.chosen].count(chosen) >= 8


@pytest.mark.slow
def test_the_slab_is_used_where_it_helps(rng):
    people, sites, features, compliance = cohort(rng, noise=0.05)
    hidden = rng.normal(0, 1.0, len(compliance))
    for slab, helps in ((hidden, True), (rng.normal(0, 1.0, len(hidden)), False)):
        found = predict_left_out(
            people, sites, features, compliance * np.exp(hidden), lambda train, slab=slab: slab
        )
        assert [each["with_slab"] for each in found.chosen].count(helps) >= 9
        assert (percent_off(found.predicted, compliance * np.exp(hidden)).mean() < 8.0) == helps


def test_the_interval_of_the_mean_keeps_people_together(rng):
    """Eight rows of a person that are all alike tell as much as one."""
    own = rng.standard_normal(60)
    people, values = np.repeat(np.arange(60), 8).astype(str), np.repeat(own, 8)
    low, high = mean_interval(people, values)
    expected = 1.96 * own.std() / np.sqrt(60)
    assert (high - low) / 2 == pytest.approx(expected, rel=0.1)
    alone = mean_interval(np.arange(480).astype(str), values)
    assert (alone[1] - alone[0]) / 2 == pytest.approx(expected / np.sqrt(8), rel=0.1)
