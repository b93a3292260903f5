"""The environment's limit on threads holds for whoever asks for more."""

from __future__ import annotations

import pytest

from limbcli.config import THREADS, at_most
from limbcli.stages.fitting.force_curves import available_cores


def test_threads_are_at_most_those_that_the_environment_allows(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(THREADS, raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert at_most(2) == 2
    for said, allowed in (("1", 1), ("8", 2), ("0", 1), ("many", 2), ("", 2)):
        monkeypatch.setenv(THREADS, said)
        assert at_most(2) == allowed
    monkeypatch.setenv(THREADS, "1")
    assert available_cores() == 1


def test_what_is_said_to_all_programs_holds_where_this_one_is_told_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(THREADS, raising=False)
    for said, allowed in (("1", 1), ("1,4", 1), ("8", 2), ("0", 1), ("FALSE", 2), ("", 2)):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert at_most(2) == allowed
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv(THREADS, "2")
    assert at_most(2) == 2
