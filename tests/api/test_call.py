"""Results say the call they came from."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.api.call import records_call
from limbcli.results import provenance


@records_call
def simulate(case: object, *, m: float = 1.0, progress: object = None) -> str:
    return str(provenance()["command"])


def test_a_result_of_a_call_says_the_call(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["/usr/lib/ipykernel_launcher.py", "-f", "kernel-1.json"])
    said = simulate(Path("my limb"), m=2.5, progress=print)
    assert said == "limbcli.simulate('my limb', m=2.5)"
    assert provenance()["command"].startswith("ipykernel_launcher.py"), "only while it is at work"


def test_a_call_that_fails_leaves_nothing_behind():
    @records_call
    def fail() -> None:
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        fail()
    assert "limbcli.fail" not in provenance()["command"]
