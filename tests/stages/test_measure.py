"""measure: the instruments' files of one site become its levels.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from limbcli.case import Case
from limbcli.errors import CaseError, MeasurementError
from limbcli.measurement.indentation import read_levels
from limbcli.stages.measure import measure
from tests.measurement.test_bmode import frame, speckle
from tests.measurement.test_holds import record
from tests.measurement.test_swe_image import BAR, BOX, ramp, render
from tests.test_case_text import HEAD, SITE

FORCES = (0.0, 2.0, 4.0, 6.0)
BONE_ROWS = (300.0, 290.0, 279.0, 270.0)
TABLES = f"""
[site.load_cell]
file = "cell.csv"
columns = {{ time_s = "t", force_n = "F" }}
force_unit = "kgf"
[site.b_mode]
folder = "bmode"
mm_per_pixel = 0.1
[site.swe_images]
folder = "swe"
mm_per_pixel = 0.1
box_pixels = {list(BOX)}
bar_pixels = {list(BAR)}
low_m_per_s = 0.5
high_m_per_s = 10.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case whose site p1 has a load-cell record in kgf and PNG images of four levels."""
    rng = np.random.default_rng(7)
    folder = tmp_path_factory.mktemp("case")
    for name in ("mri", "bmode", "swe"):
        (folder / name).mkdir()
    (folder / "case.toml").write_text(HEAD + SITE.format(name="p1") + TABLES)
    trace = record(rng, levels=FORCES)
    pairs = zip(trace.time, trace.force / 9.80665, strict=True)
    rows = "\n".join(f"{time:.4f};{force:.6f}".replace(".", ",") for time, force in pairs)
    (folder / "cell.csv").write_text("t;F\n" + rows + "\n")
    tissue = speckle(rng)
    for k, row in enumerate(BONE_ROWS):
        Image.fromarray(frame(rng, row, tissue).rgb).save(folder / "bmode" / f"{k}.png")
        speed = np.clip(ramp() * (1 + 0.1 * k), 0, 10)
        Image.fromarray(render(rng, speed).rgb).save(folder / "swe" / f"{k}.png")
    return folder


def test_levels_are_those_the_instruments_saw(folder: Path, tmp_path: Path):
    result = measure(Case.open(folder), out=tmp_path)[0]
    levels = read_levels(result.path("levels"))
    np.testing.assert_allclose(levels.force, FORCES, atol=0.02)
    np.testing.assert_allclose(levels.depth, (300.0 - np.array(BONE_ROWS)) * 0.1, atol=0.1)
    np.testing.assert_allclose(levels.swe_mean_m_per_s, 5.0 * (1 + 0.1 * np.arange(4)), rtol=0.02)
    for name in ("holds_picture", "bone_picture", "speed_picture"):
        assert result.path(name).stat().st_size > 10_000
    assert len(list((result.folder / "swe").glob("level_*.csv"))) == 4


def test_levels_are_written_to_the_case_once_and_never_over_a_file(folder: Path, tmp_path: Path):
    case = Case.open(folder)
    measure(case, out=tmp_path, write=True)
    try:
        assert len(read_levels(case.sites[0].levels)) == 4
        with pytest.raises(CaseError, match="not overwritten"):
            measure(case, out=tmp_path, write=True)
    finally:
        case.sites[0].levels.unlink()


def test_missing_image_is_said_with_the_counts(folder: Path, tmp_path: Path):
    extra = folder / "bmode" / "3.png"
    content = extra.read_bytes()
    extra.unlink()
    try:
        with pytest.raises(MeasurementError, match="as many levels: force_n 4"):
            measure(Case.open(folder), out=tmp_path)
    finally:
        extra.write_bytes(content)
    assert not (tmp_path / "measure" / "p1").exists(), "nothing half-made stays"


def test_missing_levels_are_only_allowed_where_instruments_give_them(folder: Path):
    case = Case.open(folder)
    with pytest.raises(MeasurementError, match="limbcli measure"):
        read_levels(case.sites[0].levels)


ONLY_CELL = '[site.load_cell]\nfile = "cell.csv"\ncolumns = { time_s = "t", force_n = "F" }\n'


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda time, force: (time, 102.0 * force), "spans .* to 6.. N"),
        (lambda time, force: (time, -force), "the sign turned"),
        (lambda time, force: (1000.0 * time, force), "milliseconds"),
        (lambda time, force: (time, 0.0 * force), "one level only"),
        (lambda time, force: (time, np.full(len(force), np.nan)), "0 of .* samples"),
    ],
    ids=["grams", "sign", "milliseconds", "one level", "no force"],
)
def test_a_record_that_cannot_be_meant_is_refused(folder: Path, tmp_path: Path, rng, change, says):
    with pytest.raises(MeasurementError, match=says):
        measure(cell_only(folder, tmp_path, *change(*times_and_forces(rng))), out=tmp_path / "out")


def test_lost_samples_and_tiny_forces_are_doubted(folder: Path, tmp_path: Path, rng):
    time, force = times_and_forces(rng)
    result = measure(cell_only(folder, tmp_path, time, force / 9.81), out=tmp_path / "out")[0]
    assert any("kgf" in text for text in result.warnings)
    force[::5] = np.nan
    result = measure(cell_only(folder, tmp_path, time, force), out=tmp_path / "out")[0]
    assert any("hold no force" in text for text in result.warnings)
    assert not any("kgf" in text for text in result.warnings)


def times_and_forces(rng) -> tuple[np.ndarray, np.ndarray]:
    trace = record(rng, levels=FORCES)
    return trace.time.copy(), trace.force.copy()


def cell_only(folder: Path, place: Path, time: np.ndarray, force: np.ndarray) -> Case:
    """The case with nothing but a load-cell record."""
    place = place / "cell"
    (place / "mri").mkdir(parents=True, exist_ok=True)
    (place / "case.toml").write_text(HEAD + SITE.format(name="p1") + ONLY_CELL)
    rows = "\n".join(f"{a:.4f},{'' if np.isnan(b) else f'{b:.6f}'}" for a, b in zip(time, force, strict=True))
    (place / "cell.csv").write_text("t,F\n" + rows + "\n")
    return Case.open(place)
