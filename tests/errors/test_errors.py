"""Errors travel between processes with all they say."""

from __future__ import annotations

import pickle

import pytest

from limbcli.errors import CaseError, SolveError
from limbcli.fem.equilibrium.newton import NotConverged
from limbcli.stages.batching.cluster import WorkerRefused


@pytest.mark.parametrize("family", [CaseError, SolveError, NotConverged, WorkerRefused])
def test_an_error_arrives_as_it_was_sent(family):
    sent = family("it stopped", where="level 7", fix="more steps", residual=3.1e-2)
    got = pickle.loads(pickle.dumps(sent))
    assert type(got) is family
    assert (str(got), got.what, got.where, got.fix, got.facts, got.exit_code) == (
        str(sent), "it stopped", "level 7", "more steps", {"residual": 3.1e-2}, family.exit_code,
    )  # fmt: skip
