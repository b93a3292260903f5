"""The speeds that a fitted model predicts: right at rest, on the measured pixels, and honest about gaps."""

import csv
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting.predicted_speeds import write_speeds
from limbcli.materials.ogden import ogden_type
from limbcli.measurement.elastography import SweMap, read_map, write_map
from limbcli.measurement.indentation import read_levels
from limbcli.model import ElementMap
from limbcli.results import open_stage, read_result
from limbcli.shear_waves.speed import element_speeds
from limbcli.site_model.indentation_model import indentation_model, with_tissue
from limbcli.solvers.session import ReferenceSession
from tests.stages import block_case as block

pytestmark = pytest.mark.slow

DEPTHS = np.array([1.2, 2.4, 3.6])
C = 0.008  # MPa: 2 m/s


@pytest.fixture(scope="module")
def solved():
    model = indentation_model(block.block_model(), schedule(list(DEPTHS)), c=C, f_kappa=60.0, m=4.0)
    session = ReferenceSession(model)
    result = session.solve(records=True)
    session.close()
    return model, result


def case_with(folder: Path, maps: dict[int, str | SweMap], *, speeds: np.ndarray | None) -> Case:
    case = block.make_case(
        folder, folder.parent / "out", DEPTHS, np.array([2.0, 5.0, 9.0]), c=C, build=False, speeds=speeds
    )
    if maps:
        text = case.file.read_text().replace('"levels.csv"', '"levels.csv"\nswe_maps = "swe"')
        case.file.write_text(text)
        (folder / "swe").mkdir()
    for level, content in maps.items():
        path = folder / "swe" / f"level_{level:02d}.csv"
        path.write_text(content) if isinstance(content, str) else write_map(path, content)
    return Case.open(folder)


def predict(solved, case: Case, out: Path):
    model, result = solved
    site = case.sites[0]
    with open_stage(out, "fit", subject="B1", site="p1") as writer:
        write_speeds(model, result.simulation, read_levels(site.levels), site, writer)
    return read_result(out, "fit", site="p1")


def grid(half: float = 6.0) -> SweMap:
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(-half, half + 1), np.arange(2.0, 11.0)))
    return SweMap(lateral, depth, np.full(len(lateral), 2.1))


def table(result) -> dict[str, list[str]]:
    with result.path("swe").open() as stream:
        rows = list(csv.DictReader(stream))
    return {name: [row[name] for row in rows] for name in rows[0]}


def test_predictions_stand_on_the_pixels_that_were_measured(solved, tmp_path):
    case = case_with(tmp_path / "case", {0: grid(), 2: grid(4.0)}, speeds=np.array([2.1, 2.3, 2.6]))
    result = predict(solved, case, tmp_path / "out")
    for level, half in ((0, 6.0), (2, 4.0)):
        found = read_map(result.path(f"swe_level_{level:02d}"))
        assert set(zip(found.lateral, found.depth, strict=True)) == set(
            zip(grid(half).lateral, grid(half).depth, strict=True)
        )
    assert result.data["swe"]["n_measured_maps"] == 2
    assert set(result.provenance["inputs_sha256"]) == {"swe_map_level_0", "swe_map_level_2"}
    for name in ("swe_picture", "swe_maps_picture"):
        assert result.path(name).stat().st_size > 0


def test_at_rest_every_pixel_shows_the_tissue_s_own_speed_and_load_raises_it(solved, tmp_path):
    case = case_with(tmp_path / "case", {0: grid()}, speeds=np.array([2.1, 2.3, 2.6]))
    result = predict(solved, case, tmp_path / "out")
    np.testing.assert_allclose(read_map(result.path("swe_level_00")).speed_m_per_s, 2.0, rtol=1e-4)
    means = np.array([float(each) for each in table(result)["predicted_m_per_s"]])
    assert (np.diff(means) > 0.02).all()
    forces = [float(each) for each in table(result)["simulated_force_n"]]
    np.testing.assert_allclose(forces, np.r_[0.0, solved[1].must_points.forces], rtol=1e-5, atol=1e-9)


def test_the_gap_told_is_that_of_the_means_under_load(solved, tmp_path):
    case = case_with(tmp_path / "case", {}, speeds=np.array([2.1, 2.3, 2.6]))
    result = predict(solved, case, tmp_path / "out")
    means = np.array([float(each) for each in table(result)["predicted_m_per_s"]])
    expected = np.sqrt(np.mean((means[1:] - [2.1, 2.3, 2.6]) ** 2))
    assert result.data["swe"]["rmse_m_per_s"] == pytest.approx(expected, rel=1e-4)


def test_without_readings_under_load_only_the_prediction_is_left(solved, tmp_path):
    result = predict(solved, case_with(tmp_path / "case", {}, speeds=None), tmp_path / "out")
    assert result.data["swe"]["n_measured_maps"] == 0
    assert result.data["swe"]["rmse_m_per_s"] is None
    assert table(result)["measured_m_per_s"][1:] == ["", "", ""]
    assert not result.warnings


def test_a_map_that_cannot_be_read_is_left_out_and_told(solved, tmp_path):
    faulty = "lateral_mm,depth_mm,speed_m_per_s\n0,5,210\n"
    case = case_with(tmp_path / "case", {0: grid(), 1: faulty}, speeds=None)
    result = predict(solved, case, tmp_path / "out")
    assert result.data["swe"]["n_measured_maps"] == 1
    assert any("level_01.csv" in text and "210" in text for text in result.warnings)


def test_without_records_of_the_deformation_the_fit_goes_on_with_a_warning(solved, tmp_path):
    model, _ = solved
    session = ReferenceSession(model)
    bare = session.solve()
    session.close()
    result = predict((model, bare), case_with(tmp_path / "case", {}, speeds=None), tmp_path / "out")
    assert "swe" not in result.files
    assert any("no shear-wave speeds" in text for text in result.warnings)


def test_a_map_of_stiffness_gives_each_element_its_own_speed(solved, rng):
    model, _ = solved
    n = len(model.mesh.block("tissue").cells)
    c = rng.uniform(0.004, 0.02, n)
    mapped = with_tissue(model, c=ElementMap("c", "tissue", c), f_kappa=60.0, m=4.0)
    items = rng.choice(n, 5, replace=False)
    F = np.eye(3) + rng.uniform(-0.15, 0.15, (5, 3, 3))
    found = element_speeds(mapped, F, items, density_kg_per_m3=1000.0)
    for k, item in enumerate(items):
        uniform = model.with_material("tissue", ogden_type(c=float(c[item]), f_kappa=60.0, m=4.0))
        alone = element_speeds(uniform, F[k : k + 1], items[k : k + 1], density_kg_per_m3=1000.0)
        assert found[k] == pytest.approx(alone[0], rel=1e-12)
