"""Load-cell records as their programs write them."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.recording import RecordingFormat, read_recording

LVM = """LabVIEW Measurement
Writer_Version\t2
Separator\tTab
Decimal_Separator\t,
***End_of_Header***

Channels\t2
Samples\t3
***End_of_Header***
X_Value\tForce\tComment
0,000\t0,10
0,017\t1,25
0,033\t2,50
"""


def test_labview_file_with_decimal_commas(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(LVM)
    trace = read_recording(path, RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"}))
    np.testing.assert_allclose(trace.time, [0, 0.017, 0.033])
    np.testing.assert_allclose(trace.force, [0.1, 1.25, 2.5])


@pytest.mark.parametrize(
    ("unit", "factor"), [("N", 1.0), ("kgf", 9.80665), ("gf", 9.80665e-3), ("lbf", 4.4482216)]
)
def test_force_units_are_converted(tmp_path, unit, factor):
    path = tmp_path / "a.csv"
    path.write_text("time_s,force_n\n0,1\n1,2\n")
    trace = read_recording(path, RecordingFormat(force_unit=unit))
    np.testing.assert_allclose(trace.force, [factor, 2 * factor])


def test_semicolons_and_decimal_commas_are_found_out(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("time_s;force_n;Gerät\n0,0;1,5;x\n0,5;2,5;x\n".encode("latin-1"))
    np.testing.assert_allclose(read_recording(path).force, [1.5, 2.5])


@pytest.mark.parametrize(
    ("text", "form", "expected"),
    [
        ("time_s,load\n0,1\n1,2\n", RecordingFormat(), "no column 'force_n'"),
        ("time_s,load\n0,1\n1,2\n", RecordingFormat(columns={"force_n": "Load"}), "did you mean 'load'"),
        ("time_s,force_n\n0,1\n0,2\n", RecordingFormat(), "does not grow"),
        ("time_s,force_n\n0,1\n1,x\n", RecordingFormat(), "not a number"),
        ("time_s,force_n\n", RecordingFormat(), "no rows"),
    ],
)
def test_wrong_record_is_refused_with_a_fix(tmp_path, text, form, expected):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError) as caught:
        read_recording(path, form)
    assert expected in str(caught.value)
    assert "fix:" in str(caught.value)
