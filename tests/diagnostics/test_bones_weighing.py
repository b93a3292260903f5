"""Two limbs, each with the effects that it takes: which is believed, and what is told where neither is."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnostics.conclusions.sentences import sentences
from limbcli.diagnostics.conclusions.verdict import Diagnosis, Shrink
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Explanation, Fitted
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.stages.diagnosis.bones.bone_comparison import (
    combined_diagnosis,
    may_be_elsewhere,
    weighed,
    with_bone_warnings,
)
from limbcli.stages.diagnosis.bones.bone_hypotheses import OtherBones
from limbcli.stages.diagnosis.bones.evidence import Evidence

BASE = Fitted((), np.zeros(1), np.zeros((1, 1)), ("m",), {"m": 1.5})


def found(verdict: str, *fitting: Explanation, m: tuple[float, float] = (2.0, 3.0)) -> Diagnosis:
    chosen = fitting[0] if fitting and verdict != "unexplained" else ()
    base = Shrink((), 60.0, 30, {}, {}, Reported({"m": 1.5}, {}, {"m": (1.2, 1.8)}))
    last = Shrink(chosen, 30.0, 29, {}, {}, Reported({"m": 2.5}, {}, {"m": m}))
    blank = dict.fromkeys((each.name for each in dataclasses.fields(Diagnosis)), ())
    given = blank | {
        "verdict": verdict, "reason": "why", "base": BASE, "refits": (),
        "family": Family((), None, 0.05), "confidence_set": fitting, "chosen": chosen,
        "shrink": (base, last) if chosen else (dataclasses.replace(base, estimates=last.estimates),),
    }  # fmt: skip
    return Diagnosis(**given)


TILT, PAIR = ("tilt",), ("preload", "fat")


@pytest.mark.parametrize(
    ("ours", "theirs", "gain", "expected"),
    [
        (found("named", TILT), found("adequate"), 0.0, "either"),  # one effect, or other bones alone
        (found("named", TILT), found("adequate"), 20.0, "other bones"),
        (found("named", TILT), found("adequate"), -20.0, "as segmented"),
        (found("ambiguous", PAIR), found("adequate"), 0.0, "other bones"),
        (found("ambiguous", PAIR), found("adequate"), -20.0, "either"),
        (found("ambiguous", PAIR), found("named", TILT), 0.0, "either"),
        (found("named", TILT), found("named", TILT), 0.0, "as segmented"),
        (found("named", TILT), found("named", TILT), 20.0, "either"),
        (found("unexplained"), found("ambiguous", PAIR), 0.0, "other bones"),
        (found("unexplained", TILT), found("named", TILT), -20.0, "either"),
        (found("named", TILT), found("unexplained", TILT), 0.0, "as segmented"),
        (found("unexplained"), found("unexplained"), 0.0, "either"),
    ],
)  # fmt: skip
def test_the_limb_that_takes_less_and_fits_better(ours, theirs, gain, expected):
    assert weighed(ours, theirs, gain=gain, required=12.0) == expected


def test_bones_that_are_wrong_as_segmented_are_no_further_assumption():
    ours, theirs = found("named", TILT), found("named", ("preload",))
    assert weighed(ours, theirs, gain=0.0, required=12.0) == "as segmented"
    assert weighed(ours, theirs, gain=0.0, required=12.0, is_repair=True) == "either"
    assert weighed(ours, theirs, gain=13.0, required=12.0, is_repair=True) == "other bones"


def test_nothing_missing_is_not_looked_for_on_another_limb():
    assert not may_be_elsewhere(found("adequate"))
    assert not may_be_elsewhere(found("untestable"))
    assert may_be_elsewhere(found("unexplained"))


def test_either_limb_gives_all_that_fits_and_c_and_m_of_any():
    ours = found("named", TILT, m=(2.0, 3.0))
    reported = combined_diagnosis(
        ours, found("ambiguous", ("fat", "preload"), TILT, m=(2.5, 4.0)), "without bone_2"
    )
    assert reported.verdict == "ambiguous"
    assert "without bone_2" in reported.reason
    assert reported.confidence_set == (TILT, ("fat", "preload"))
    assert reported.estimates.intervals["m"] == (2.0, 4.0)
    assert reported.estimates.values["m"] == 2.5
    assert reported.estimates.over == 3
    assert reported.shrink[0].estimates.intervals["m"] == (1.2, 1.8)
    same_pair = combined_diagnosis(found("ambiguous", PAIR), found("ambiguous", ("fat", "preload")), "x")
    assert same_pair.confidence_set == (PAIR,)


def test_nothing_is_said_of_a_next_measurement_where_none_was_compared():
    reported = combined_diagnosis(found("named", TILT), found("named", ("preload",)), "without bone_2")
    assert len(reported.confidence_set) == 2
    assert not any("Next measurement" in each for each in sentences(replace(reported, not_evaluated={})))


@pytest.mark.parametrize(
    ("effects", "words"), [(TILT, "one missing effect explains"), (PAIR, "two missing effects explain")]
)
def test_the_verdict_says_how_many_effects_it_names(effects, words):
    for more in ((), ((*effects, "friction"),)):
        reported = replace(found("named", effects, *more), not_evaluated={})
        assert sentences(reported)[0].startswith(f"NAMED: {words} the misfit")


def test_what_explains_nothing_adds_nothing():
    ours = found("named", TILT)
    assert combined_diagnosis(ours, found("unexplained", PAIR), "x") is ours
    reported = combined_diagnosis(found("unexplained"), found("named", TILT), "x")
    assert (reported.verdict, reported.confidence_set) == ("unexplained", ())
    assert "see `bones`" in reported.reason


WITHOUT = OtherBones("without bone_2", 12.0, left_out=("bone_2",))
PUT_BACK = OtherBones("with bone_2 put back", 10.0, moved={"bone_2": np.ones(3)})


@pytest.mark.parametrize(
    ("other", "stand", "verdict"),
    [(WITHOUT, "taken", "named"), (WITHOUT, "open", "ambiguous"), (WITHOUT, "not taken", "named"),
     (PUT_BACK, "taken", "ambiguous"), (PUT_BACK, "open", "ambiguous"), (PUT_BACK, "not taken", "named")],
)  # fmt: skip
def test_no_name_on_a_limb_whose_bones_were_moved(other, stand, verdict):
    reported = with_bone_warnings(found("named", TILT), [Evidence(other, 50.0, 20, True, stand)])
    assert reported.verdict == verdict
    assert reported.confidence_set == (TILT,)
    assert ("(see `bones`)" in reported.reason) == (verdict == "ambiguous")
    assert (
        with_bone_warnings(found("adequate"), [Evidence(other, 50.0, 20, True, stand)]).verdict == "adequate"
    )
