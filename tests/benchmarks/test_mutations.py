"""The table of wrong physics fits the package as it is: each slip can be made, and its test is there."""

from __future__ import annotations

import pytest

from tests.benchmarks.mutations import REPOSITORY, SLIPS, Slip


@pytest.mark.parametrize("slip", SLIPS, ids=lambda each: each.what)
def test_each_slip_has_one_place_and_a_test(slip: Slip):
    text = (REPOSITORY / "limbcli" / slip.file).read_text(encoding="utf-8")
    assert text.count(slip.old) == 1
    assert slip.new != slip.old
    file, _, name = slip.test.partition("::")
    tests = (REPOSITORY / file).read_text(encoding="utf-8")
    assert f"def {name}(" in tests if name else "def test" in tests or ">>>" in tests
