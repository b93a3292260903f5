"""TDMS files, written here by npTDMS with the properties that LabVIEW and NI-DAQmx give their channels."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import MeasurementError, ToolError
from limbcli.measurement.load_cell_record import RecordingFormat, read_recording

FORCE = np.r_[np.zeros(100), np.full(100, 2.0)]
NAMED = RecordingFormat(columns={"force_n": "Force"})


def write(path: Path, *channels: tuple[str, str, np.ndarray, dict[str, object]]) -> Path:
    nptdms = pytest.importorskip("nptdms", reason="npTDMS (extra tdms) is not installed")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject(*each) for each in channels])
    return path


def wave(step: float, **more: object) -> dict[str, object]:
    return {"wf_increment": step, "wf_start_offset": 0.5, "wf_samples": 1, **more}


def test_a_channel_s_rate_start_and_unit_are_read(tmp_path):
    path = write(
        tmp_path / "a.tdms",
        ("Load", "Force", FORCE, wave(0.01, unit_string="kgf")),
        ("Load", "Depth (cm)", FORCE / 10, wave(0.01)),
        ("Load", "Voltage", np.arange(7.0), wave(0.02, unit_string="V")),
    )
    trace = read_recording(path, NAMED)
    np.testing.assert_allclose(trace.time, 0.5 + 0.01 * np.arange(200))
    np.testing.assert_allclose(trace.force, 9.80665 * FORCE)
    assert trace.depth is not None
    np.testing.assert_allclose(trace.depth, FORCE)
    assert "force in kgf" in trace.converted


def test_times_may_be_a_channel_of_numbers_or_of_clock_times(tmp_path):
    clock = np.datetime64("2024-05-01T10:00:00", "us") + (np.arange(200) * 10_000).astype("timedelta64[us]")
    for times, unit in ((10.0 * np.arange(200), {"unit_string": "ms"}), (clock, {})):
        path = write(
            tmp_path / "a.tdms", ("g", "Time", times, unit), ("g", "Force", FORCE, {"unit_string": "N"})
        )
        trace = read_recording(path, RecordingFormat(columns={"time_s": "Time", "force_n": "Force"}))
        np.testing.assert_allclose(trace.time, 0.01 * np.arange(200), atol=1e-9)


def test_channels_of_one_name_are_told_apart_by_their_group(tmp_path):
    path = write(
        tmp_path / "a.tdms", ("a", "Force", FORCE, wave(0.01)), ("b", "Force", 2 * FORCE, wave(0.01))
    )
    trace = read_recording(path, RecordingFormat(columns={"force_n": "b/Force"}))
    np.testing.assert_allclose(trace.force, 2 * FORCE)
    with pytest.raises(MeasurementError, match="'a/Force', 'b/Force'"):
        read_recording(path, NAMED)


def test_units_that_are_not_a_force_or_contradict_the_case_are_refused(tmp_path):
    path = write(tmp_path / "a.tdms", ("g", "Force", FORCE, wave(0.01, unit_string="V")))
    with pytest.raises(MeasurementError, match="unit 'V'"):
        read_recording(path, NAMED)
    path = write(tmp_path / "a.tdms", ("g", "Force", FORCE, wave(0.01, unit_string="N")))
    with pytest.raises(MeasurementError, match="force_unit = 'kgf'"):
        read_recording(path, RecordingFormat(columns={"force_n": "Force"}, force_unit="kgf"))


def test_a_record_faster_than_10_khz_is_averaged_as_the_file_states_its_times(tmp_path):
    force = np.repeat(FORCE, 1000)  # 4 s at 50 kHz
    trace = read_recording(write(tmp_path / "a.tdms", ("g", "Force", force, wave(2e-5))), NAMED)
    assert len(trace.force) == len(force) // 50
    assert np.median(np.diff(trace.time)) == pytest.approx(1e-3)
    assert trace.time[0] == pytest.approx(0.5 + 24.5 * 2e-5)
    np.testing.assert_allclose(trace.force, np.repeat(FORCE, 20))
    assert "means of 50 samples" in trace.converted


def test_an_averaged_record_needs_a_unit_of_time_in_the_file(tmp_path):
    path = tmp_path / "a.csv"
    rows = "".join(f"{k * 2e-5:.5f},{k % 2}\n" for k in range(5000))
    path.write_text("time_s,force_n\n" + rows)
    with pytest.raises(MeasurementError, match="samples per second"):
        read_recording(path)
    path.write_text("Time (s),force_n\n" + rows)
    np.testing.assert_allclose(read_recording(path).force, 0.5)


def test_a_record_without_times_or_force_or_damaged_is_refused(tmp_path):
    path = write(tmp_path / "a.tdms", ("g", "Force", FORCE, {}))
    with pytest.raises(MeasurementError, match="no column 'time_s'"):
        read_recording(path, NAMED)
    with pytest.raises(MeasurementError, match="its channels: 'Force'"):
        read_recording(path)
    content = path.read_bytes()
    for damaged in (content[:40], content[:-900], b"TDSm" + bytes(range(256)) * 9):
        path.write_bytes(damaged)
        with pytest.raises(MeasurementError) as caught:
            read_recording(path, NAMED)
        assert caught.value.what.isprintable()


def test_without_nptdms_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    (tmp_path / "a.tdms").write_bytes(b"TDSm" + bytes(99))
    with pytest.raises(ToolError, match=r"limbcli\[tdms\]"):
        read_recording(tmp_path / "a.tdms")


def test_a_file_that_was_cut_short_is_refused_and_its_bytes_are_not_shown(tmp_path, capfd):
    path = write(tmp_path / "a.tdms", ("Load", "Force", FORCE, wave(0.01, unit_string="N")))
    whole = path.read_bytes()
    path.write_bytes(whole[:-200])
    with pytest.raises(MeasurementError, match="cut short") as caught:
        read_recording(path, NAMED)
    assert caught.value.fix
    path.write_bytes(whole.replace(b"Force", b"For\xffe"))
    with pytest.raises(MeasurementError):
        read_recording(path, NAMED)
    assert capfd.readouterr() == ("", "")
