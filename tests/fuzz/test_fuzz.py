"""Damaged files are refused with a way out, or read soundly: a seeded part of tests/benchmarks/fuzz.py.

`python -m tests.benchmarks.fuzz` tries 20,000; what it found stays below as cases of their own.
"""

from __future__ import annotations

import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from limbcli.case import read_case
from limbcli.errors import CaseError, LimbError, MeasurementError, MeshError, SolveError
from limbcli.feb.log import read_log
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.imaging.dicom import read_series
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.surface import read_surface
from limbcli.measurement.indentation import check_levels
from limbcli.measurement.ultrasound_image import read_image
from limbcli.meshing import surfaces
from limbcli.model.npz_file import load_model
from tests.fuzz.targets import (
    TARGETS,
    Target,
    make_dicom,
    make_log,
    make_model,
    make_nifti,
    make_picture,
    make_records,
    make_surface,
    sound_levels,
)
from tests.fuzz.trial import GOOD, judge, try_one

N_EACH = 25
SEED = 7


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=[each.name for each in TARGETS])
def test_damaged_files_are_refused_or_read_soundly(target: Target, tmp_path: Path) -> None:
    if target.needs:
        pytest.importorskip(target.needs)
    target.make(tmp_path)
    good = (tmp_path / target.file).read_bytes()
    assert target.name == "case.toml" or judge(target, tmp_path).outcome in GOOD
    for number in range(N_EACH):
        trial = try_one(target, tmp_path, good, (SEED, number))
        assert trial.outcome in GOOD, f"{target.name}, seed {(SEED, number)}: {trial}"


def test_a_reader_that_fails_would_be_seen(tmp_path: Path) -> None:
    def reader(path: Path) -> Any:
        raise IndexError(path.name)

    target = Target("broken", "a.csv", True, lambda folder: None, reader)
    (tmp_path / "a.csv").write_text("1")
    assert judge(target, tmp_path).outcome == "traceback"
    assert (
        judge(Target("b", "a.csv", True, target.make, lambda path: 1, lambda found: False), tmp_path)
        != "read"
    )


# ---------------------------------------------------------------- properties

plain = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.just("p1"), st.just("left")
)
cells = st.one_of(
    st.floats(-20, 80).map(str), st.floats().map(str), st.sampled_from(["", "nan", "load", "1,5"])
)
few = settings(max_examples=150, derandomize=True, deadline=None,
               suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip


def toml_text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(c):08X}" for c in value if not 0xD800 <= ord(c) < 0xE000) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_text, value)) + "]"
    return "0" if value is None else str(value)


KEYS = (
    "id", "limb", "mri", "labels", "skin", "bones", "length_mm", "width_mm", "edge_radius_mm", "margin_mm",
    "element", "name", "position_mm", "marker", "long_axis", "levels", "trace", "swe_maps", "format",
)  # fmt: skip
tables = st.dictionaries(st.sampled_from(KEYS), st.one_of(plain, st.lists(plain, max_size=3)), max_size=9)


@pytest.mark.slow
@few
@given(content=st.dictionaries(st.sampled_from(["subject", "imaging", "probe", "model", "other"]), tables),
       sites=st.lists(tables, max_size=2))  # fmt: skip
def test_any_case_toml_gives_a_case_or_problems(tmp_path: Path, content: dict, sites: list) -> None:
    lines = ["format = 1"]
    for name, table in [*content.items(), *(("[site]", each) for each in sites)]:
        lines += [f"[{name}]", *(f"{key} = {toml_text(value)}" for key, value in table.items())]
    (tmp_path / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    case, problems = read_case(tmp_path)
    assert case is not None or any(each.severity == "error" for each in problems)


@pytest.mark.slow
@few
@given(rows=st.lists(st.tuples(cells, cells, cells), min_size=1, max_size=6))
def test_any_levels_give_sound_levels_or_problems(tmp_path: Path, rows: list[tuple[str, str, str]]) -> None:
    path = tmp_path / "levels.csv"
    path.write_text("\n".join(["force_n,depth_mm,swe_mean_m_per_s", *map(",".join, rows)]) + "\n")
    assert sound_levels(check_levels(path))


# ---------------------------------------------------------------- what was found


def refused(read: Any, path: Path, family: type[LimbError] = CaseError) -> None:
    with pytest.raises(family) as caught:
        read(path)
    assert caught.value.fix


@pytest.mark.parametrize("read", [read_surface, surfaces.read_surface])
def test_a_ply_whose_header_does_not_end_is_no_endless_loop(tmp_path: Path, read: Any) -> None:
    make_surface("a.ply", binary=True)(tmp_path)
    path = tmp_path / "a.ply"
    path.write_bytes(path.read_bytes()[:60])
    refused(read, path, LimbError)


@pytest.mark.parametrize("face", ["f 1 2 99", "f 1 2 -9223372036854775808", "f 1 2 99999999999999999999"])
def test_a_triangle_of_an_absent_point_is_refused(tmp_path: Path, face: str) -> None:
    path = tmp_path / "a.obj"
    path.write_text(f"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n{face}\n")
    refused(read_surface, path)
    refused(surfaces.read_surface, path, MeshError)


def test_triangles_without_area_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 9 0 0\nf 1 2 2\n")
    refused(read_surface, path)
    refused(surfaces.read_surface, path, MeshError)


def test_a_packed_label_map_with_damaged_content_is_refused(tmp_path: Path) -> None:
    make_nifti("labels.nii.gz")(tmp_path)
    path = tmp_path / "labels.nii.gz"
    content = bytearray(path.read_bytes())
    for at in range(40, 80):
        content[at] ^= 0x5A
    path.write_bytes(bytes(content))
    refused(read_label_file, path)


def test_a_label_map_said_to_be_vast_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    image = nib.Nifti1Image(np.zeros((4, 4, 4), np.uint8), np.eye(4))
    path = tmp_path / "labels.nii"
    nib.save(image, path)
    content = bytearray(path.read_bytes())
    struct.pack_into("<3h", content, 42, 32000, 32000, 32000)
    path.write_bytes(bytes(content))
    refused(read_label_file, path)


def test_a_model_file_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: Any) -> None:
    make_model(tmp_path)
    load_model(tmp_path / "model.npz")
    monkeypatch.setattr("limbcli.model.npz_file._LARGEST", 1000)
    refused(load_model, tmp_path / "model.npz")


def test_a_model_file_with_a_damaged_member_is_refused(tmp_path: Path) -> None:
    make_model(tmp_path)
    path = tmp_path / "model.npz"
    with zipfile.ZipFile(path) as packed:
        start = packed.infolist()[0].header_offset
    content = bytearray(path.read_bytes())
    for at in range(start + 60, start + 90):
        content[at] ^= 0xFF
    path.write_bytes(bytes(content))
    refused(load_model, path)


@pytest.mark.parametrize("name", ["MR_small.dcm", "MR_small_jp2klossless.dcm", "JPGExtended.dcm"])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.97])
def test_a_dicom_file_cut_short_is_not_passed_over(tmp_path: Path, name: str, share: float) -> None:
    """The last slice: without it the series would merely be shorter."""
    make_dicom(name)(tmp_path)
    path = tmp_path / "slice3.dcm"
    content = path.read_bytes()
    path.write_bytes(content[: max(200, int(share * len(content)))])
    refused(read_series, tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("*Time  = 0.5", "*Time  = nan"), ("*Time  = 0.5", "*Time  = 0.1"), ("*Time  = 0.5", "*Time  = inf"),
        ("*Step  = 2", "*Step  = 99999999999999999999"), ("\n5,", "\n-5,"), ("\n5,", "\n5.5,"),
        ("\n5,", "\nnan,"),
    ],
)  # fmt: skip
def test_records_with_impossible_times_or_ids_are_refused(tmp_path: Path, old: str, new: str) -> None:
    make_records(tmp_path)
    path = tmp_path / "nodes.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    refused(read_records, path, SolveError)


@pytest.mark.parametrize("number", ["nan", "inf", "1e400", "-3"])
def test_totals_of_a_log_that_are_no_numbers_do_not_count(tmp_path: Path, number: str) -> None:
    make_log(tmp_path)
    path = tmp_path / "model.log"
    lines = path.read_text().splitlines()
    changed = [
        line.rpartition(":")[0] + f": {number}" if "Total number" in line or "Number of eq" in line else line
        for line in lines
    ]
    assert changed != lines
    path.write_text("\n".join(changed) + "\n")
    log = read_log(path)
    assert 0 <= log.n_iterations < 100


@pytest.mark.parametrize("at", [12, 35, 60])
def test_a_picture_with_a_broken_chunk_is_refused(tmp_path: Path, at: int) -> None:
    make_picture(tmp_path)
    path = tmp_path / "image.png"
    content = path.read_bytes()
    path.write_bytes(content[:at] + b"\xff" * 6 + content[at + 6 :])
    refused(lambda each: read_image(each, mm_per_pixel=0.1), path, MeasurementError)


def made(name: str, folder: Path) -> Path:
    """The good file of a kind of input."""
    target = next(each for each in TARGETS if each.name == name)
    target.make(folder)
    return folder / target.file


def test_a_facet_with_a_node_number_beyond_all_is_refused(tmp_path: Path) -> None:
    path = made(".feb", tmp_path)
    text = path.read_text()
    before, found, rows = text.partition("<Surface ")
    assert found
    path.write_text(before + found + re.sub(r">(\s*\d+)\s*,", f">{10**30},", rows, count=1))
    refused(read_feb, path, CaseError)


def test_an_array_whose_header_ends_early_is_refused(tmp_path: Path) -> None:
    """What numpy's reader of such a header raises is no ValueError."""
    path = made("model.npz", tmp_path)
    header = b"{'descr': '<f8', 'shape': ("
    with zipfile.ZipFile(path) as packed:
        parts = {each: packed.read(each) for each in packed.namelist()}
    first = next(iter(parts))
    parts[first] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    with zipfile.ZipFile(path, "w") as packed:
        for name, content in parts.items():
            packed.writestr(name, content)
    refused(load_model, path, LimbError)


def test_a_segmentation_whose_modality_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path = made("DICOM SEG", tmp_path)
    content = path.read_bytes()
    modality = b"\x08\x00\x60\x00CS"
    assert content.count(modality) == 1
    path.write_bytes(content.replace(modality, b"\x08\x00\x60\x00CR"))
    refused(read_label_file, path, CaseError)
