"""Curves are read as the stages wrote them."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.reporting.curves import read_curves, read_run_curve
from limbcli.results import StageResult


def test_every_force_column_is_a_curve_sampled_at_the_levels(tmp_path):
    text = "depth_mm,measured_n,start_n,ogden_n\n0,0,0,0\n1.5,,6,3\n2,4,8,4.5\n"
    (tmp_path / "curves.csv").write_text(text)
    start, ogden = read_curves(StageResult("fit", "S1", tmp_path, "p1"), np.array([-0.1, 2.0, 2.5]))
    assert (start.key, ogden.key, ogden.label) == ("start", "ogden", "Ogden type")
    np.testing.assert_array_equal(ogden.depth, [0, 1.5, 2])
    np.testing.assert_array_equal(start.force, [0, 6, 8])
    np.testing.assert_array_equal(ogden.at_levels, [0, 4.5, np.nan])


def test_a_runs_curve_begins_at_first_touch(tmp_path):
    (tmp_path / "force-depth.csv").write_text("time_s,depth_mm,force_n\n0.5,1,2\n1,2,5\n")
    curve = read_run_curve(StageResult("run", "S1", tmp_path, "p1"))
    np.testing.assert_array_equal(curve.depth, [0, 1, 2])
    np.testing.assert_array_equal(curve.force, [0, 2, 5])


@pytest.mark.parametrize("text", [None, "", "a,b\n1,2\n", "depth_mm,ogden_n\n1,x\n", "depth_mm,ogden_n\n1\n"])
def test_a_broken_file_says_which_and_what_to_do(tmp_path, text):
    if text is not None:
        (tmp_path / "curves.csv").write_text(text)
    with pytest.raises(CaseError, match="cannot be read") as caught:
        read_curves(StageResult("fit", "S1", tmp_path, "p1"))
    assert "curves.csv" in caught.value.where
    assert "limbcli fit" in caught.value.fix
