"""fit --stiffness-map: c(x) from the level-0 map, in the law, in the files, and in what comes out."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import Case, StatedNoise
from limbcli.errors import CaseError, MeasurementError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import ReferenceCurve
from limbcli.fitting.stiffness_map import TissueMap, tissue_map
from limbcli.measurement.elastography import SweMap, write_map
from limbcli.model import ElementMap
from limbcli.site_model.indentation_model import indentation_model, with_tissue
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.fit import START, FitOptions, check_choice, fit
from tests.stages import block_case as block

pytestmark = pytest.mark.slow

DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])
SOFT, STIFF = 0.005, 0.016
TRUTH = {"f_kappa": 60.0, "m": 4.0}
MAP = FitOptions(stiffness_map=True, intervals=False)


@pytest.fixture(scope="module")
def model():
    return indentation_model(block.block_model(), schedule(list(DEPTHS)), c=0.008, f_kappa=100.0, m=2.0)


def of_cells(model, c) -> ElementMap:
    """A map of c from a function of the middles of the cells."""
    return ElementMap("c", "tissue", c(model.mesh.points[model.mesh.block("tissue").cells].mean(axis=1)))


def layered(x: np.ndarray) -> np.ndarray:
    """Soft down to 6 mm, three times as stiff below."""
    return np.where(x[:, 2] > -6.0, SOFT, STIFF)


def pixels(c_at) -> SweMap:
    """What the scanner reads of c(x) at first touch."""
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(-10, 11.0), np.arange(1, 16.0)))
    c = c_at(np.column_stack([lateral, np.zeros_like(lateral), -depth]))
    return SweMap(lateral, depth, np.sqrt(c * 1e6 / 2000.0))


def test_a_map_tells_its_median_by_what_all_pixels_share_and_the_mean_of_their_own_noise():
    """c goes as the square of the speed: of 400 pixels with 80 % each, and 3 % that they share, 10 %."""
    swe = SweMap(np.zeros(400), np.zeros(400), np.full(400, 2.0))
    found = TissueMap(ElementMap("c", "tissue", np.full(3, 0.008)), swe, 0.008, 3, 0)
    site = SimpleNamespace(noise=StatedNoise(swe_pixel_fraction=0.8, swe_level_fraction=0.03))
    stiffness = found.stiffness(site)
    assert (stiffness.c, stiffness.log_deviation) == pytest.approx((0.008, 0.1))


def measured(folder: Path, forces: np.ndarray, swe: SweMap | None) -> Case:
    """The block's case with this map of level 0; levels.csv tells the mean speed under the probe."""
    c = 0.008 if swe is None or not len(swe) else float(np.median(2e-3 * swe.speed_m_per_s**2))
    case = block.make_case(folder / "case", folder / "out", DEPTHS, forces, c=c)
    if swe is None:
        return case
    text = case.file.read_text().replace('levels = "levels.csv"', 'levels = "levels.csv"\nswe_maps = "swe"')
    case.file.write_text(text)
    (case.folder / "swe").mkdir()
    write_map(case.folder / "swe" / "level_00.csv", swe)
    return Case.open(case.folder)


def test_a_uniform_map_gives_the_forces_and_derivatives_of_uniform_c(model):
    uniform = of_cells(model, lambda x: np.full(len(x), 0.008))
    number, mapped = (ReferenceCurve(model, c=c)(START, (0, 1)) for c in (0.008, uniform))
    np.testing.assert_allclose(mapped.values, number.values, rtol=1e-9)
    np.testing.assert_allclose(mapped.jacobian, number.jacobian, rtol=1e-9)


def test_derivatives_with_a_map_are_those_of_differences(model):
    curve = ReferenceCurve(model, c=of_cells(model, layered))
    exact = curve(START, (0, 1))
    for k, step in ((0, 0.02), (1, 5e-4)):
        forces = []
        for sign in (1, -1):
            theta = START.copy()
            theta[k] += sign * step
            forces.append(curve(theta, (0, 1)).values)
        np.testing.assert_allclose((forces[0] - forces[1]) / (2 * step), exact.jacobian[:, k], rtol=1e-3)
    curve.close()


@pytest.fixture(scope="module")
def fits(model, tmp_path_factory):
    """Forces of the layered block, fitted with the map that was read of it, and with its median alone."""
    true = with_tissue(model, c=of_cells(model, layered), **TRUTH)
    session = ReferenceSession(true)
    forces = session.solve().must_points.forces
    session.close()
    folder = tmp_path_factory.mktemp("layers")
    case = measured(folder, forces, pixels(layered))
    found = {}
    for name, options in (("plain", FitOptions(intervals=False)), ("map", MAP)):
        result = fit(case, out=folder / "out", solver="reference", options=options)[0]
        found[name] = {**result.to_json(), "folder": result.folder, "feb": read_feb(result.path("feb"))}
    return found


@pytest.mark.slow
def test_two_stiffnesses_are_recovered_with_their_map_and_missed_without(fits):
    """Not to the digit: a map is as blurred as its pixels are averaged (3 mm)."""
    mapped, plain = fits["map"]["data"], fits["plain"]["data"]
    assert mapped["f_kappa"] == pytest.approx(TRUTH["f_kappa"], rel=0.2)
    assert mapped["m"] == pytest.approx(TRUTH["m"], rel=0.1)
    assert abs(plain["f_kappa"] / TRUTH["f_kappa"] - 1) > 0.4


@pytest.mark.slow
def test_the_fitted_model_carries_the_map(fits):
    data, law = fits["map"]["data"], fits["map"]["feb"].materials["tissue"].parameters
    assert {name for name, value in law.items() if isinstance(value, ElementMap)} == {"c1", "c2", "kappa"}
    c = law["c1"].values + law["c2"].values
    np.testing.assert_allclose(law["kappa"].values, data["f_kappa"] * c, rtol=1e-12)
    assert 1e3 * c.min() == pytest.approx(data["stiffness_map"]["low_kpa"], rel=1e-12)
    assert 1e3 * c.max() == pytest.approx(data["stiffness_map"]["high_kpa"], rel=1e-12)
    assert "MeshData" in (fits["map"]["folder"] / "material.feb").read_text()


@pytest.mark.slow
def test_the_result_tells_which_map_and_how_much_of_the_model_it_covers(fits):
    reported = fits["map"]["data"]["stiffness_map"]
    assert reported["map"] == "level_00.csv"
    assert reported["n_pixels"] == 21 * 15
    assert 0 < reported["n_elements_within_image"] < reported["n_elements"] == 864
    assert reported["low_kpa"] < reported["median_kpa"] <= reported["high_kpa"]
    assert (fits["map"]["folder"] / "stiffness-map.png").stat().st_size > 0
    assert "swe_map_level_0" in fits["map"]["provenance"]["inputs_sha256"]
    json.dumps(fits["map"]["data"], allow_nan=False)


@pytest.mark.parametrize(
    ("swe", "error", "message"),
    [
        (None, CaseError, "no shear-wave maps"),
        (
            SweMap(np.arange(-6.0, 8), np.arange(80.0, 94) ** 1.05, np.full(14, 2.0)),
            MeasurementError,
            "outside the model",
        ),
        (
            SweMap(np.arange(60.0, 74), np.arange(1.0, 15) ** 1.05, np.full(14, 2.0)),
            MeasurementError,
            "image ends at 10 mm",
        ),
        (SweMap(np.zeros(0), np.zeros(0), np.zeros(0)), MeasurementError, "level_00.csv"),
        (SweMap(np.arange(4.0), np.arange(4.0), np.full(4, 2.0)), MeasurementError, "4 pixels"),
    ],
    ids=["no maps", "beside the model", "too wide", "all pixels masked", "few pixels"],
)
def test_a_map_that_cannot_serve_is_refused(model, tmp_path, swe, error, message):
    case = measured(tmp_path, np.array([1.0, 2.0, 3.0, 4.0]), swe)
    with pytest.raises(error, match=message) as raised:
        tissue_map(model, case.sites[0])
    assert raised.value.fix


def test_a_missing_level_0_is_told_apart_from_missing_maps(model, tmp_path):
    case = measured(tmp_path, np.array([1.0, 2.0, 3.0, 4.0]), pixels(layered))
    (case.sites[0].swe_maps / "level_00.csv").rename(case.sites[0].swe_maps / "level_01.csv")
    with pytest.raises(MeasurementError, match="no shear-wave map of level 0"):
        tissue_map(model, case.sites[0])


def test_c_by_hand_and_a_map_exclude_each_other(tmp_path):
    case = measured(tmp_path, np.array([1.0, 2.0, 3.0, 4.0]), pixels(layered))
    with pytest.raises(CaseError, match="twice"):
        fit(case, out=tmp_path / "out", solver="reference", options=FitOptions(c_kpa=6.0, stiffness_map=True))
    with pytest.raises(CaseError, match="stiffness map"):
        check_choice("joint", FitOptions(stiffness_map=True))
