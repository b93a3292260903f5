"""Do the readings speak for a limb with other bones: which limbs are asked about, and the likelihoods."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from limbcli.meshing.surfaces import tetrahedron
from limbcli.stages.diagnosis.bones.bone_hypotheses import OtherBones, _from_face, _in_reach
from limbcli.stages.diagnosis.bones.evidence import Evidence, compared, is_poor_fit
from limbcli.stages.diagnosis.data.rows import Row
from limbcli.stages.diagnosis.place import Place

SEEN = OtherBones("without bone_2", 12.0, left_out=("bone_2",))


def model_of(y: np.ndarray, covariance: np.ndarray, rows: list[Row]) -> SimpleNamespace:
    class Data(SimpleNamespace):
        def __len__(self) -> int:
            return len(self.y)

    data = Data(y=y, noise=SimpleNamespace(covariance=covariance))
    return SimpleNamespace(data=data, sites=[SimpleNamespace(site=SimpleNamespace(rows=tuple(rows)))])


def fit_of(prediction: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(prediction=prediction, jacobian=np.zeros((len(prediction), 2)))


def test_the_gain_is_that_of_the_likelihood_of_what_both_limbs_predict(rng):
    """A bone hides parts of a map: those count for neither limb."""
    rows = [Row("force", k) for k in range(4)] + [Row("map", 0, part) for part in range(3)]
    root = rng.standard_normal((7, 7))
    covariance, y = root @ root.T + np.eye(7), rng.standard_normal(7)
    ours, theirs = rng.standard_normal(6), rng.standard_normal(7)
    keep = np.array([0, 1, 2, 3, 4, 6])  # part 1 of the map lies within the bone
    first = model_of(y[keep], 2.0 * covariance[np.ix_(keep, keep)], [rows[k] for k in keep])
    found = compared(SEEN, first, fit_of(ours), model_of(y, covariance, rows), fit_of(theirs))
    by_hand = 2.0 * (
        multivariate_normal(theirs[keep], covariance[np.ix_(keep, keep)]).logpdf(y[keep])
        - multivariate_normal(ours, 2.0 * covariance[np.ix_(keep, keep)]).logpdf(y[keep])
    )
    assert found.gain == pytest.approx(by_hand)
    assert found.n == 6


def test_a_limb_has_to_beat_the_best_effect_unless_it_is_decisive():
    rows, covariance, y = [Row("force", k) for k in range(20)], np.eye(20), np.zeros(20)
    model = model_of(y, covariance, rows)
    for off, speaks, decisive in ((0.7, False, False), (1.0, True, False), (2.0, True, True)):
        found = compared(SEEN, model, fit_of(np.full(20, off)), model, fit_of(y))
        assert found.gain == pytest.approx(20 * off**2)
        assert (found.speaks_for_it, found.is_decisive) == (speaks, decisive)
    assert found.beats(66.0)  # 80 of 66, 12, and 20 readings' share of another mesh
    assert not found.beats(69.0)
    bad = compared(SEEN, model, fit_of(np.full(20, 3.0)), model, fit_of(np.full(20, 1.5)))
    assert bad.gain == pytest.approx(135.0)
    assert not bad.is_decisive  # it leaves something


def test_the_page_says_what_came_of_a_limb_with_other_bones():
    rows, covariance, y = [Row("force", k) for k in range(5)], np.eye(5), np.zeros(5)
    model = model_of(y, covariance, rows)
    found = compared(SEEN, model, fit_of(np.full(5, 2.0)), model, fit_of(y))
    assert found.sentence == ""
    assert "are not accepted there" in replace(found, stand="taken").sentence
    assert "these data do not show whether" in replace(found, stand="open").sentence
    assert replace(found, stand="taken").to_json()["taken"] is True
    back = OtherBones("with bone_2 put back", 4.0, moved={"bone_2": np.ones(3)})
    worse = compared(back, model, fit_of(y), model, fit_of(np.full(5, 2.0)))
    assert worse.gain == pytest.approx(-20.0)
    assert "deviance +20" in worse.sentence


def test_rivals_wait_until_the_effects_have_been_looked_at():
    closed: list[str] = []

    def place(name: str) -> Place:
        return Place([SimpleNamespace(close=lambda: closed.append(name))], None, Path(name))

    weak = Evidence(SEEN, 20.0, 30, fits=True)
    ends = (
        (5.0, "other", "taken", ["own"]), (15.0, "own", "open", []), (31.0, "own", "open", []),
        (35.0, "own", "not taken", ["other"]),
    )  # fmt: skip
    for effect_gain, chosen, stand, gone in ends:
        closed.clear()
        own, other = place("own"), place("other")
        own.rivals, own.given_up = [(weak, other)], ["tried"]
        found = own.better_than(effect_gain, is_named=False)
        waiting = [each.stand for each, _ in found.rivals]
        assert (found.out.name, [each.stand for each in found.bones] + waiting) == (chosen, [stand])
        assert (closed, found.given_up) == (gone, ["tried"])
        for evidence, rival in list(found.rivals):
            found.settled(evidence, rival)
            assert (found.rivals, found.bones) == ([], [evidence])
        found.close()
        assert sorted(closed) == ["other", "own"]


@pytest.mark.parametrize(("named", "waits"), [(False, True), (True, False)])
def test_a_limb_with_mended_bones_waits_for_its_effects_where_none_is_named_on_the_other(named, waits):
    """One of several effects is better by more than the bones alone: it may be theirs."""
    back = OtherBones("with bone_2 put back", 4.0, moved={"bone_2": np.ones(3)})
    own, other = (Place([SimpleNamespace(close=lambda: None)], None, Path(each)) for each in ("own", "other"))
    own.rivals = [(Evidence(back, 20.0, 30, fits=True), other)]
    found = own.better_than(60.0, is_named=named)
    assert found is own
    assert [rival for _, rival in found.rivals] == ([other] if waits else [])
    assert len(found.bones) == (not waits)


def test_a_bad_fit_is_told_by_its_chi2():
    model = model_of(np.zeros(12), np.eye(12), [Row("force", k) for k in range(12)])
    assert not is_poor_fit(model, fit_of(np.full(12, 1.2)), 0.05)  # 17.3 on 10
    assert is_poor_fit(model, fit_of(np.full(12, 1.3)), 0.05)  # 20.3 on 10


def test_a_bone_is_left_out_moved_or_as_it_was():
    bone = tetrahedron()
    assert SEEN.of("bone_2", bone) is None
    assert not SEEN.is_repair
    assert np.array_equal(SEEN.of("bone_1", bone).points, bone.points)
    back = OtherBones("put back", 4.0, moved={"bone_2": np.array([1.0, 2.0, 3.0])})
    assert back.is_repair
    assert back.of("bone_2", bone).points == pytest.approx(bone.points + np.array([1.0, 2.0, 3.0]))


def test_only_bones_as_near_as_the_others_are_asked_about():
    def at(depth: float):
        shift = np.eye(4)
        shift[2, 3] = -depth
        return tetrahedron().moved(shift)

    assert _from_face(np.array([[0.0, 0, -20], [30.0, 0, -1]]), 53.0, 14.0) == pytest.approx(np.hypot(3.5, 1))
    bones = {"bone_1": at(40.0), "bone_2": at(20.0), "bone_3": at(48.0), "bone_4": at(55.0)}
    minor = {name: bones[name] for name in ("bone_2", "bone_3", "bone_4")}
    assert _in_reach(minor, bones, [np.eye(4)], 53.0, 14.0) == ["bone_2", "bone_3"]
    assert _in_reach(bones, bones, [np.eye(4)], 53.0, 14.0) == []  # no other bone would be left
