"""Errors travel between processes with all they say."""

from __future__ import annotations

import pickle

import pytest

from limbcli.errors import CaseError, SolveError, errors_of_site
from limbcli.errors.pasted_commands import pasted
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


def test_an_error_keeps_its_site_through_copies_and_later_blocks():
    with pytest.raises(SolveError) as caught, errors_of_site("p1 + p10"), errors_of_site("p1"):
        raise SolveError("it stopped", where="layers of p10", fix="more steps")
    assert (caught.value.site, caught.value.where) == ("p1", "site p1, layers of p10")
    copies = [pickle.loads(pickle.dumps(caught.value)), pasted(caught.value, None)]
    assert [each.site for each in copies] == ["p1", "p1"]


@pytest.mark.parametrize("where", ["site p1", "site p1, levels.csv", "p1: model.log", "mesh p1"])
def test_a_site_that_the_place_states_is_not_written_twice(where):
    with pytest.raises(SolveError) as caught, errors_of_site("p1"):
        raise SolveError("it stopped", where=where, fix="more steps")
    assert (caught.value.site, caught.value.where) == ("p1", where)
