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


def test_labview_segments_are_joined_and_different_columns_are_refused(tmp_path):
    path = tmp_path / "a.lvm"
    form = RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"})
    again = LVM[LVM.index("Channels") :].replace("0,0", "1,0")
    path.write_text(LVM + again)
    np.testing.assert_allclose(
        read_recording(path, form).time, [0, 0.017, 0.033, 1.0, 1.017, 1.033], err_msg="no segment is lost"
    )
    path.write_text(LVM + again.replace("Force", "Torque"))
    with pytest.raises(MeasurementError, match="different columns"):
        read_recording(path, form)
    path.write_text(LVM + LVM[LVM.index("Channels") :])
    with pytest.raises(MeasurementError, match="does not increase"):
        read_recording(path, form)


@pytest.mark.parametrize("clocks", [("10:59:59,5", "11:00:02,75"), ("23:59:59,5", "00:00:02,75")])
def test_labview_times_that_begin_again_count_from_when_each_segment_was_begun(tmp_path, clocks):
    path = tmp_path / "a.lvm"
    form = RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"})
    days = ("2024/02/28", "2024/02/29" if clocks[1] < clocks[0] else "2024/02/28")
    segment = LVM[LVM.index("Channels") :]
    reported = [f"\nDate\t{day}\nTime\t{clock}0000000\n" for day, clock in zip(days, clocks, strict=True)]
    parts = [segment.replace("\nSamples\t3\n", each) for each in reported]
    path.write_text(LVM[: LVM.index("Channels")] + "".join(parts))
    trace = read_recording(path, form)
    np.testing.assert_allclose(trace.time, [0, 0.017, 0.033, 3.25, 3.267, 3.283], atol=1e-6)
    np.testing.assert_allclose(trace.force, [0.1, 1.25, 2.5] * 2)


def test_labview_file_without_times_gets_them_from_its_step(tmp_path):
    path = tmp_path / "a.lvm"
    form = RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"})
    header = "X_Columns\tNo\n***End_of_Header***\t\n\nChannels\t1\nX0\t2,0E+0\nDelta_X\t0,016667\n"
    path.write_text(
        "LabVIEW Measurement\nSeparator\tTab\n" + header + "***End_of_Header***\t\n"
        "X_Value\tForce\tComment\n\t0,10\n\t1,25\n\t2,50\n"
    )
    trace = read_recording(path, form)
    np.testing.assert_allclose(trace.time, [2.0, 2.016667, 2.033334])
    np.testing.assert_allclose(trace.force, [0.1, 1.25, 2.5])
    path.write_text(path.read_text().replace("Delta_X", "Delta"))
    with pytest.raises(MeasurementError, match="has no times"):
        read_recording(path, form)


def test_labview_channels_sampled_apart_have_each_its_own_time(tmp_path):
    path = tmp_path / "a.lvm"
    form = RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"})
    rows = "X_Value\tTilt\tX_Value\tForce\tComment\n0,0\t5\t0,0\t0,1\n0,001\t5\t0,1\t1,5\n0,002\t5\n"
    path.write_text(LVM[: LVM.index("X_Value")] + rows)
    np.testing.assert_allclose(read_recording(path, form).time, [0.0, 0.1])
    with pytest.raises(MeasurementError, match="depth_mm were sampled at different times"):
        read_recording(path, RecordingFormat(columns={**form.columns, "depth_mm": "Tilt"}))
    path.write_text(
        "LabVIEW Measurement\nSeparator\tTab\nX_Columns\tNo\n***End_of_Header***\nChannels\t2\n"
        "X0\t0\t3712345678.5\nDelta_X\t0.001\t0.25\n***End_of_Header***\n"
        "X_Value\tTilt\tForce\tComment\n\t1\t2\n\t1\t3\n\t1\n"
    )
    np.testing.assert_array_equal(read_recording(path, form).time, [3712345678.5, 3712345678.75])
    comma = RecordingFormat(columns=form.columns, decimal=",")
    np.testing.assert_array_equal(read_recording(path, comma).force, [2.0, 3.0])


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


def test_comments_and_utf_16_are_read(tmp_path):
    path = tmp_path / "a.csv"
    text = "# cell 3, as set up\ntime_s,force_n\n0,1.5\n# a pause\n1,2.5\n"
    path.write_text(text, encoding="utf-16")
    np.testing.assert_allclose(read_recording(path).force, [1.5, 2.5])
    path.write_text("# t,F\n0,1.5\n1,2.5\n")
    named = RecordingFormat(columns={"time_s": "# t", "force_n": "F"})
    np.testing.assert_allclose(read_recording(path, named).force, [1.5, 2.5])


def test_a_labview_file_repeats_the_time_before_every_channel(tmp_path):
    path = tmp_path / "a.lvm"
    rows = "X_Value\tForce\tX_Value\tDepth\tComment\n0,0\t0,1\t0,0\t5\n0,1\t1,5\t0,1\t6\n"
    path.write_text(LVM[: LVM.index("X_Value")] + rows)
    trace = read_recording(path, RecordingFormat(columns={"time_s": "X_Value", "force_n": "Force"}))
    np.testing.assert_allclose(trace.time, [0.0, 0.1])


@pytest.mark.parametrize(
    ("text", "form", "expected"),
    [
        ("time_s,load\n0,1\n1,2\n", RecordingFormat(), "no column 'force_n'"),
        ("time_s,load\n0,1\n1,2\n", RecordingFormat(columns={"force_n": "Load"}), "did you mean 'load'"),
        ("time_s,force_n\n0,1\n0,2\n", RecordingFormat(), "does not increase"),
        ("time_s,force_n\n0,1\n1,x\n", RecordingFormat(), "not a number"),
        ("time_s,force_n,force_n\n0,1,9\n1,2,9\n", RecordingFormat(), "2 columns of the record are called"),
        ("time_s,force_n\n", RecordingFormat(), "no rows"),
        ("time_s;force_n\n0,0;900\n1,0;1.234\n", RecordingFormat(), "marks between thousands"),
        ('time_s,force_n\n0,1\n\n1,"2\n' + "2,3\n" * 40000, RecordingFormat(), "line 4"),
    ],
)
def test_wrong_record_is_refused_with_a_fix(tmp_path, text, form, expected):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError) as caught:
        read_recording(path, form)
    assert expected in str(caught.value)
    assert "fix:" in str(caught.value)


def test_a_time_of_day_is_refused_with_what_to_write_instead(tmp_path):
    path = tmp_path / "cell.csv"
    path.write_text("time_s,force_n\n14:59:50.0,0.1\n14:59:50.1,0.2\n")
    with pytest.raises(MeasurementError) as found:
        read_recording(path)
    assert found.value.fix == "write seconds: a time of day or a date is not read as time"
