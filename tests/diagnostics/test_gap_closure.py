"""Whether a gap is closed: better than placebos that were picked as the explanation was, and it predicts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.diagnostics.engine import diagnose
from limbcli.diagnostics.selection import gap_closure
from limbcli.diagnostics.selection.gap_closure import Closing
from tests.diagnostics import toy


@pytest.mark.parametrize(
    ("n_effects", "falls", "alone", "picked", "closed"),
    [(1, True, 99.4, 89.0, False), (1, True, 99.9, 97.0, True), (1, False, 99.9, 97.0, False),
     (1, True, 94.0, 97.0, False), (2, True, 99.9, 97.0, False), (2, True, 99.9, 99.5, True),
     (3, True, 100.0, 100.0, False)],
)  # fmt: skip
def test_a_name_beats_placebos_that_were_picked_out_of_as_many(
    monkeypatch, n_effects, falls, alone, picked, closed
):
    """The best of nineteen beats 99.4 % of single placebos by chance at one limb in nine."""
    monkeypatch.setattr(gap_closure, "fell", lambda *errors: falls)
    monkeypatch.setattr(gap_closure, "held_out_error", lambda data, fitted: {})
    monkeypatch.setattr(Closing, "percentile", lambda self, refit: alone)
    monkeypatch.setattr(gap_closure, "library_percentile", lambda *given, **how: picked)
    channels = SimpleNamespace(blocks={}, order=np.zeros(1), deviation=np.ones(1), channels=dict)
    baseline = SimpleNamespace(
        data=channels, state=SimpleNamespace(chi2=10.0), whiten=None, rng=lambda k: None,
        base=SimpleNamespace(jacobian=np.zeros((1, 2))),
    )  # fmt: skip
    refit = SimpleNamespace(
        explanation=tuple("abc"[:n_effects]), state=SimpleNamespace(chi2=5.0),
        fitted=SimpleNamespace(jacobian=np.zeros((1, 3)), base_names=("c", "m")),
    )  # fmt: skip
    assert Closing(baseline, 19).is_closed(refit) is closed


class HeldAtItsBound(toy.Toy):
    """One curve of the three cannot move once the offset is there, as m on its bound."""

    def fit(self, explanation, start):
        found = super().fit(explanation, start)
        if explanation != ("offset",):
            return found
        note = "m ended on its bound 20 and is held there"
        jacobian = np.delete(found.jacobian, 1, axis=1)
        return replace(found, jacobian=jacobian, base_names=("c", "k"), notes=(note,))


def test_an_effect_with_which_m_ends_on_its_bound_is_told_with_that_doubt(rng):
    data = HeldAtItsBound(toy.make(rng, {"offset": 6.0}).y)
    found = diagnose(data, n_draws=1000, propose=False)
    assert found.verdict == "ambiguous"
    assert ("offset",) in found.confidence_set
