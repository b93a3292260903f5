"""Load-cell records as their programs write them."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.load_cell_record import RecordingFormat, read_recording
from limbcli.measurement.trace import check_trace

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
        ("time_s,force_n\nNaN,1\n", RecordingFormat(), "1 row(s) have no time, the first is row 1"),
        ("time_s,force_n\n0,1\n,2\n1,3\n", RecordingFormat(), "the first is row 2"),
        ("time_s,force_n,force_n\n0,1,9\n1,2,9\n", RecordingFormat(), "2 columns of the record are called"),
        ("time_s,force_n\n", RecordingFormat(), "no rows"),
        ("Time,Force\n0,1\n1,2\n", RecordingFormat(), "did you mean 'Time'"),
        ("0,1\n1,2\n", RecordingFormat(), "begin the file with the names of its columns"),
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


@pytest.mark.parametrize(
    "times",
    [
        ("14:59:59.5", "15:00:00", "15:00:00.25"),
        ("23:59:59,5", "00:00:00,0", "0:00:00,25"),
        ("2024-02-29T23:59:59.5", "2024-03-01 00:00:00.0", "2024-03-01 00:00:00.250"),
        ("2024-03-01T10:59:59.5+01:00", "2024-03-01T11:00:00+01:00", "2024-03-01T11:00:00.25+01:00"),
        ("29.02.2024 23:59:59,5", "01.03.2024 00:00:00,0", "01.03.2024 0:00:00,25"),
        ("3/1/2024 11:59:59.5 AM", "3/1/2024 12:00:00.0 PM", "3/1/2024 12:00:00.25 pm"),
        ("2024/02/29 23:59:59.5", "2024/03/01 00:00:00", "2024/3/1 00:00:00.25"),
    ],
)
def test_times_of_day_count_from_the_first(tmp_path, times):
    path = tmp_path / "cell.csv"
    path.write_text("Time;Force\n;N\n" + "".join(f"{time};0,{k}\n" for k, time in enumerate(times)))
    trace = read_recording(path)
    np.testing.assert_allclose(trace.time, [0.0, 0.5, 0.75])
    np.testing.assert_allclose(trace.force, [0.0, 0.1, 0.2])
    path.write_text(f"time_s,force_n\n{times[0].replace(',', '.')},0\n0.5,1\n")
    with pytest.raises(MeasurementError, match="first row has a time of day") as found:
        read_recording(path)
    assert "write all times alike" in found.value.fix


def test_a_date_whose_order_is_unknown_may_only_change_at_midnight(tmp_path):
    path = tmp_path / "cell.csv"
    path.write_text("Timestamp,Force (N)\n01.03.2024 12:00:00,0\n03.03.2024 12:00:01,1\n")
    with pytest.raises(MeasurementError, match=r"changes from '01.03.2024' to '03.03.2024'") as found:
        read_recording(path)
    assert "year-month-day" in found.value.fix


def test_a_column_of_lengths_that_is_not_read_is_told(tmp_path):
    path = tmp_path / "cell.csv"
    path.write_text("Time (s),Extension (mm),Load (N),Note\n0,0,0,a\n0.1,1,1,b\n")
    assert "not read: 'Extension (mm)'" in read_recording(path).converted
    named = read_recording(path, RecordingFormat(columns={"depth_mm": "Extension"}))
    assert named.depth is not None
    assert "not read" not in named.converted


@pytest.mark.parametrize(
    "text",
    [
        '"Results Table 1"\n"","Maximum Load"\n"1","2.5"\n\n"Raw Data"\n"Time","Extension","Load"\n'
        '"(s)","(mm)","(N)"\n"0","0","0"\n"0.1","-1","-1.5"\n"0.2","-2","-2.5"\n',
        "Pr\u00fcfzeit;Standardkraft;Standardweg\ns;N;mm\n0,0;0,0;0\n0,1;1,5;1\n0,2;2,5;2\n",
        "Axial Displacement\tAxial Force\tTime\nmm\tkN\tSec\n0\t0\t0\n1\t-0.0015\t0.1\n2\t-0.0025\t0.2\n",
        "Reading,Load [N],Load cell 2 [N],Elapsed Time [sec]\n1,0,0,0\n2,1.5,0,0.1\n3,2.5,0,0.2\n",
        "# time_s  force_n\n  0.0   0.0\n  0.1   1.5\n  0.2   2.5\n",
        "   Time (s)    Force (N)\n   0.0   0.0\n   0.1   1.5\n   0.2   2.5\n",
        "Zeit, s    Kraft, N\n0,0   0,0\n0,1   1,5\n0,2   2,5\n",
    ],
)
def test_records_of_testing_machines_need_no_names(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    trace = read_recording(path)
    np.testing.assert_allclose(trace.time, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(trace.force, [0.0, 1.5, 2.5])
    assert ("counted as positive" in trace.converted) == ("-" in text)


def test_headers_between_blocks_of_rows_are_passed_over(tmp_path):
    header = "Timed Data\tTime:\t9.5\tSec\nAxial Force\tTime\nN\tSec\n"
    path = tmp_path / "a.txt"
    path.write_text(f"{header}0\t0\n1.5\t0.1\n\n{header}2.5\t0.2\n3.5\t0.3\n")
    trace = read_recording(path)
    np.testing.assert_allclose(trace.time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(trace.force, [0.0, 1.5, 2.5, 3.5])


def test_titles_above_units_are_named_where_a_column_has_none(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Points,Elapsed Time ,Load 1\n,Sec,N\n1,0,0\n2,0.1,1.5\n")
    with pytest.raises(MeasurementError) as caught:
        read_recording(path)
    assert "'Load 1'" in caught.value.fix
    read = read_recording(path, RecordingFormat(columns={"force_n": "Load 1"}))
    np.testing.assert_allclose(read.force, [0.0, 1.5])


def test_our_own_names_go_before_other_words(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Elapsed Time (s),Time (ms),Load (N),Force (N)\n9,0,9,1\n9,100,9,2\n")
    np.testing.assert_allclose(read_recording(path).force, [1.0, 2.0])


@pytest.mark.parametrize("first", [-5.0, 0.6])
def test_forces_are_turned_only_of_a_record_that_begins_free_and_never_pushes(tmp_path, first):
    """A weight that hangs on the cell also reads below 0."""
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,force_n\n0,{first}\n1,-5\n2,-0.1\n")
    np.testing.assert_allclose(read_recording(path).force, [first, -5.0, -0.1])


@pytest.mark.parametrize(
    ("text", "what", "fix"),
    [
        ("Time (ms),Force (N)\n0,0,5\n20,1,5\n", "the row has 3 cells, the header 2", "semicolons or tabs"),
        ("Time (s),Force (N)\n1,0.0,0.5\n2,0.1,1.5\n", "the row has 3 cells", "every column a title"),
        ('Time (ms),Force (mN)\n0,"980"\n20,"1,017"\n40,"1,200"\n', "is it a decimal mark", "thousands"),
        ('Time (s),Force (mN)\n0.0,"980"\n0.1,"1,017"\n', "not a number", "marks between thousands"),
        ("Time,Extension,Kraftwert\n(s),(mm),(N)\n0,0,0\n1,1,1\n", "no column", "known here: 'Extension'"),
        ("Time (s),Force (dN)\n0,1\n1,2\n", "no column|unit 'dN'", "convert its numbers"),
    ],
)
def test_what_would_be_read_as_other_numbers_is_refused(tmp_path, text, what, fix):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError, match=what) as caught:
        read_recording(path)
    assert fix in caught.value.fix


SECONDS = np.arange(5) / 10.0


def rows(separator: str = ",", *, scale: float = 1.0, comma: bool = False) -> str:
    text = "\n".join(f"{scale * t:.6g}{separator}{k + 0.5}" for k, t in enumerate(SECONDS)) + "\n"
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize(
    ("header", "columns", "scale", "force"),
    [
        ("Time (ms),Force [kgf]", {}, 1000.0, 9.80665),
        ("Time (ms),Force [kgf]", {"time_s": "Time", "force_n": "Force"}, 1000.0, 9.80665),
        ("Time (ms),Force [kgf]", {"time_s": "Time (ms)", "force_n": "Force [kgf]"}, 1000.0, 9.80665),
        ("time_ms,force_kn", {}, 1000.0, 1000.0),
        ("TIME / min,Load in lbs", {"force_n": "Load"}, 1 / 60, 4.4482216152605),
        ("Time,Force\n(ms),(N)", {"time_s": "Time", "force_n": "Force"}, 1000.0, 1.0),
        ("Operator,A. B.\n\nTime,Force\n(ms),(kgf)", {}, 1000.0, 9.80665),
        ('Time,Load\n"(ms)","(lbf)"', {"force_n": "Load"}, 1000.0, 4.4482216152605),
        ("# Time (µs),Force (N) of cell 1", {"force_n": "Force of cell 1"}, 1e6, 1.0),
    ],
)
def test_units_in_the_header_are_read(tmp_path, header, columns, scale, force):
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n{rows(scale=scale)}")
    trace = read_recording(path, RecordingFormat(columns=columns))
    np.testing.assert_allclose(trace.time, SECONDS, atol=1e-6)
    np.testing.assert_allclose(trace.force, force * (np.arange(5) + 0.5))
    assert "units as the record states them: time in" in trace.converted


def test_depth_in_cm_and_acceleration_in_m_per_s2_are_converted(tmp_path):
    path = tmp_path / "a.csv"
    axes = ",".join(f"accel_{axis}_g (m/s²)" for axis in "xyz")
    path.write_text(f"time_s,force_n,Depth (cm),{axes}\n0,1,0.5,0,0,9.80665\n0.1,2,0.7,0,0,9.80665\n")
    trace = read_recording(
        path, RecordingFormat(columns={f"accel_{a}_g": f"accel_{a}_g (m/s²)" for a in "xyz"})
    )
    np.testing.assert_allclose(trace.depth, [5.0, 7.0])
    np.testing.assert_allclose(trace.acceleration_g, [[0, 0, 1.0]] * 2)


@pytest.mark.parametrize(
    ("text", "form", "what"),
    [
        (
            "Time (ms),Force (N)\n",
            {"force_unit": "kgf"},
            "unit 'N' for 'Force .N.', but .*force_unit = 'kgf'",
        ),
        ("Time (ms),Force (V)\n", {}, "unit 'V' for 'Force .V.', which is none of N, mN"),
        ("time_ms,force_n\n", {"time_unit": "s"}, "unit 'ms' for 'time_ms', but .*time_unit = 's'"),
    ],
)
def test_a_unit_that_contradicts_or_is_none_of_force_is_refused(tmp_path, text, form, what):
    path = tmp_path / "a.csv"
    path.write_text(text + rows(scale=1000.0))
    with pytest.raises(MeasurementError, match=what) as caught:
        read_recording(path, RecordingFormat(**form, columns={"force_n": "Force"} if "V" in text else {}))
    assert "unit" in caught.value.fix


def test_volts_are_taken_in_the_unit_that_the_case_states(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,Force (V)\n" + rows())
    form = RecordingFormat(columns={"force_n": "Force"}, force_unit="N")
    np.testing.assert_allclose(read_recording(path, form).force, np.arange(5) + 0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "n", "unit", "question"),
    [
        (1000.0 / 60.0, 600, None, "0.06 samples per second: are its times in ms, not in s"),
        (1.005, 50_000, None, "14 hours: are its times in ms, not in s"),  # 995 Hz in ms
        (1.005, 50_000, "ms", ""),
        (1.0, 3600, None, ""),
        (1.0, 20_000, "s", ""),  # as the case states it
        (1e-4, 600, None, ""),
        (5e-5, 600, None, "samples per second: are its times in min, not in s"),
        (1e5, 600, "s", "samples per second: are its times in us, not in s"),
        (0.01, 600, "ms", "1e.05 samples per second: are its times in s or min, not in ms"),
    ],
)
def test_a_rate_that_no_record_has_is_asked_for_its_unit(tmp_path, step, n, unit, question):
    path = tmp_path / "a.csv"
    path.write_text("time_s,force_n\n" + "\n".join(f"{step * k:.8g},1" for k in range(n)))
    if not question:
        assert len(read_recording(path, RecordingFormat(time_unit=unit)).time) == n
        return
    with pytest.raises(MeasurementError, match=question) as caught:
        read_recording(path, RecordingFormat(time_unit=unit))
    assert "time_unit" in caught.value.fix


def test_a_pause_of_hours_is_no_question(tmp_path):
    path = tmp_path / "a.csv"
    text = "\n".join(f"{start + k / 10},1" for start in (0, 20_000) for k in range(100))
    path.write_text("time_s,force_n\n" + text)
    assert len(read_recording(path).time) == 200


def test_a_trace_in_milliseconds_is_refused(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("time_s,force_n\n" + "\n".join(f"{10 * k},1" for k in range(100)))
    (found,) = check_trace(path)[1]
    assert "are its times in ms" in found.what
    assert found.severity == "error"
    path.write_text("sep=;\ntime_s;force_n\n" + rows(";"))
    trace, problems = check_trace(path)
    np.testing.assert_allclose(trace.time, SECONDS)
    assert problems == []


ABOVE = "Logger 7, serial 12\nOperator;A. B.\nDate,2024-02-28\n\nRate: 10 Hz\n"


@pytest.mark.parametrize(
    "text",
    [
        ABOVE + "time_s,force_n\n" + rows(),
        ABOVE + "time_s;force_n\n" + rows(";", comma=True),
        "sep=;\r\ntime_s;force_n\r\n" + rows(";", comma=True),
        "sep=|\ntime_s|force_n\n" + rows("|"),
        'time_s,force_n\n"0,0","0,5"\n"0,1","1,5"\n"0,2","2,5"\n"0,3","3,5"\n"0,4","4,5"\n',
        ABOVE + "# a comment\ntime_s\tnote\tforce_n\n" + rows("\ta, b; c\t"),
    ],
    ids=["lines above", "semicolons", "sep=;", "sep=|", "quoted", "tabs"],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-8-sig"])
def test_what_stands_above_the_header_and_separators_are_found_out(tmp_path, text, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    trace = read_recording(path)
    np.testing.assert_allclose(trace.time, SECONDS)
    np.testing.assert_allclose(trace.force, np.arange(5) + 0.5)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"PK\x03\x04" + bytes(range(256)) * 20, "Excel"),
        (b"TDSh" + bytes(range(256)) * 20, "TDMS"),
        (np.random.default_rng(7).bytes(5000), "no text"),
        (bytes(range(1, 256)) * 20, "no text"),
        (b"time_s,force_n\n0,\x001\n", "no text"),
    ],
)
def test_a_binary_file_is_never_shown(tmp_path, content, kind):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=f"binary file .*{kind}") as caught:
        read_recording(path)
    assert str(caught.value).isprintable() or "\n" in str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_long_cell_is_shown_in_part(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,force_n\n0,1\n1,{'x' * 5000}\n")
    with pytest.raises(MeasurementError) as caught:
        read_recording(path)
    assert len(str(caught.value)) < 400


COMMAS = """LabVIEW Measurement,
Writer_Version,2
Separator,Comma
Decimal_Separator,.
Multi_Headings,Yes
X_Columns,One
***End_of_Header***,

Channels,2,,,
Test_Name,limb, 3,
Samples,2,2,,
Date,2024/02/28,2024/02/28,,
Time,10:59:59.5,10:59:59.5,,
X_Unit_Label,ms,ms,,
Y_Unit_Label,kgf,Volts,,
X_Dimension,Time,Time,,
X0,0.0E+0,0.0E+0,,
Delta_X,100,100,,
***End_of_Header***,,,,
X_Value,Force,Tilt,Comment
0.0,0.1,5,a, b
100.0,1.5,5,
"""
SPECIAL = b"***Start_Special***,\nBinary_Data,\n\x00\x01\xff 12,13\n***End_Special***,\n"


def test_a_labview_file_with_commas_special_blocks_and_several_headers(tmp_path):
    path = tmp_path / "a.lvm"
    segment = COMMAS[COMMAS.index("Channels") :]
    later = segment.replace("10:59:59.5", "11:00:00.5").encode()
    first = COMMAS.replace("Channels", "%Channels").encode().replace(b"%", SPECIAL)
    path.write_bytes(first + SPECIAL + later + COMMAS.replace("10:59:59.5", "11:00:01.5").encode() + SPECIAL)
    trace = read_recording(path, RecordingFormat(columns={"force_n": "Force"}))
    np.testing.assert_allclose(trace.time, [0.0, 0.1, 1.0, 1.1, 2.0, 2.1])
    np.testing.assert_allclose(trace.force, 9.80665 * np.array([0.1, 1.5] * 3))
    assert trace.converted == "units as the record states them: time in ms, force in kgf"
    with pytest.raises(MeasurementError, match="unit 'Volts' for 'Tilt'"):
        read_recording(path, RecordingFormat(columns={"force_n": "Tilt"}))


def test_a_damaged_row_of_a_labview_file_is_not_taken_for_a_header(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(COMMAS.replace("0.0,0.1,5,a, b", "x,0.1,5") + COMMAS[COMMAS.index("Channels") :])
    with pytest.raises(MeasurementError, match="time_s is 'x', not a number"):
        read_recording(path, RecordingFormat(columns={"force_n": "Force"}))


def test_commas_between_columns_and_as_decimal_marks_are_refused(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(COMMAS.replace("Decimal_Separator,.", "Decimal_Separator,,"))
    with pytest.raises(MeasurementError, match="commas both between its columns and as decimal marks"):
        read_recording(path, RecordingFormat(columns={"force_n": "Force"}))


def test_a_label_g_of_labview_is_no_force(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(COMMAS.replace("kgf,Volts", "g,Volts"))
    with pytest.raises(MeasurementError, match="unit 'g' for 'Force'"):
        read_recording(path, RecordingFormat(columns={"force_n": "Force"}))
    form = RecordingFormat(columns={"force_n": "Force"}, force_unit="gf")
    np.testing.assert_allclose(read_recording(path, form).force, [0.1 * 9.80665e-3, 1.5 * 9.80665e-3])
