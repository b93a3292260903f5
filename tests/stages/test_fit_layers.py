"""Layers in the fits: predicted from the solver's displacements, told where they speak against the model."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting import layer_comparison as fitted_layers
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS
from limbcli.fitting.layer_comparison import PredictedLayers, layers_figure
from limbcli.measurement.levels import Levels
from limbcli.reporting.outcome import Outcome, Outcomes
from limbcli.reporting.sections.deformation import layers
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.material_lines import material_lines
from limbcli.stages.build_feb import build_feb
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.fit_joint import fit_joint
from tests.stages import block_case as block

C, SHAPE = 0.008, np.array([20.0, 5.0])
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])
REST = np.array([1.5, 6.5, np.nan])


def law_curve(rest=REST, **options):
    model = indentation_model(block.block_model(), schedule(list(DEPTHS)), c=C, f_kappa=100.0, m=2.0)
    lines = material_lines(model, rest)
    return LawCurve(model, LAWS["ogden"], c=C, density_kg_per_m3=1000.0, speeds=False, lines=lines, **options)


@pytest.fixture(scope="module")
def truth():
    """Forces (n,) and borders (n, 3) below the skin of the block with known parameters."""
    curve = law_curve()
    values = curve(SHAPE, (0, 1)).values
    curve.close()
    return values[:4], values[4:].reshape(4, 3)


def layered_case(root, truth, *, fat_gone=None) -> Case:
    """The block's case with layers; fat_gone (4,) mm: what the fat is thinner than the block has it."""
    forces, below = truth
    case = block.make_case(root / "case", root / "out", DEPTHS, forces, c=C, build=False)
    gone = np.zeros(4) if fat_gone is None else fat_gone
    skin, fat = below[:, 0], below[:, 1] - below[:, 0] - gone
    muscle = below[:, 2] - below[:, 1] + gone
    rows = [[1.5, 5.0, 9.5], *np.column_stack([skin, fat, muscle]).tolist()]
    path = case.folder / "levels.csv"
    head, *lines = path.read_text().splitlines()
    lines = [
        ",".join([line, *(f"{each:.9g}" for each in row)]) for line, row in zip(lines, rows, strict=True)
    ]
    path.write_text("\n".join([head + ",skin_mm,fat_mm,muscle_mm", *lines]) + "\n")
    toml = case.file.read_text()
    case.file.write_text(toml.replace("depth_mm = 0.1", "depth_mm = 0.1\nlayer_mm = 0.05"))
    case = Case.open(case.folder)
    build_feb(case, out=root / "out")
    return case


def shown(result):
    """What the page says of the layers."""
    outcomes = Outcomes((Outcome("fit", "p1", "done", "limbcli fit", result=result),))
    return layers(SimpleNamespace(outcomes=outcomes), SimpleNamespace(name="p1"))


@pytest.mark.slow
def test_derivatives_of_lines_by_the_law_are_those_of_differences():
    curve = law_curve()
    exact = curve(SHAPE, (0, 1))
    for k in range(2):
        up, down = SHAPE.copy(), SHAPE.copy()
        up[k], down[k] = 1.02 * SHAPE[k], SHAPE[k] / 1.02
        rise = ((curve(up).values - curve(down).values) / (up[k] - down[k]))[4:]
        scale = np.abs(rise).max()
        assert scale > 1e-5
        np.testing.assert_allclose(exact.jacobian[4:, k], rise, atol=0.03 * scale)
    curve.close()


def test_layers_of_a_later_cycle_have_the_numbers_of_its_rows_in_the_file(tmp_path, monkeypatch):
    """As in swe.csv: a row of either is found in levels.csv by its number."""
    nan, three, thickness = np.full(3, np.nan), np.arange(3.0), np.array([[1.5, 5.0], [1.4, 4.5], [1.3, 4.0]])
    levels = Levels(
        force=three, depth=three, swe_mean_m_per_s=nan, swe_sd_m_per_s=nan, swe_pixels=nan,
        phase=("load",) * 3, hold=nan, probe_travel=nan, skin_bone=nan, path=tmp_path / "levels.csv",
        layers={"skin": thickness[:, 0], "fat": thickness[:, 1]}, cycle=np.full(3, 2),
        rows=np.array([5, 6, 7]), n_in_file=8,
    )  # fmt: skip
    found = PredictedLayers(np.arange(3), thickness, 0.0)
    monkeypatch.setattr(fitted_layers, "predict_layers", lambda *_: found)
    site = SimpleNamespace(name="p1", noise=SimpleNamespace(layer=0.1))
    with open_stage(tmp_path, "fit", subject="S1", site="p1") as writer:
        fitted_layers.write_layers(None, None, levels, site, writer)
        with (writer.work / "layers.csv").open() as stream:
            assert [row["level"] for row in csv.DictReader(stream)] == ["5", "6", "7"]


@pytest.mark.slow
def test_fit_predicts_the_layers_and_says_that_they_agree(truth, tmp_path):
    case = layered_case(tmp_path, truth)
    (result,) = fit(
        case, out=tmp_path / "out", solver="reference",
        options=FitOptions(intervals=False, contact_check=False, boundary_check=False),
    )  # fmt: skip
    reported = result.data["layers"]
    assert reported["names"] == ["skin", "fat", "muscle"]
    assert reported["n_readings"] == 8
    assert reported["p"] > 0.5
    assert reported["measured_less_predicted"]["fat"]["rms_mm"] < 0.02
    with result.path("layers").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["fat_predicted_mm"]) for row in rows] == pytest.approx(
        [float(row["fat_measured_mm"]) for row in rows], abs=0.03
    )
    assert float(rows[0]["muscle_predicted_mm"]) == pytest.approx(9.5)
    assert result.path("layers_picture").is_file()
    assert shown(result).mood == "fine"
    assert shown(result).pictures[0].source == result.path("layers_picture")


@pytest.mark.slow
def test_soft_fat_is_told_by_the_fit(truth, tmp_path):
    case = layered_case(tmp_path, truth, fat_gone=np.array([0.15, 0.3, 0.45, 0.6]))
    (result,) = fit(
        case, out=tmp_path / "out", solver="reference",
        options=FitOptions(intervals=False, contact_check=False, boundary_check=False),
    )  # fmt: skip
    reported = result.data["layers"]
    assert reported["p"] < 1e-6
    assert reported["measured_less_predicted"]["fat"]["last_mm"] == pytest.approx(-0.6, abs=0.05)
    assert any("the layers do not move as in this model" in text for text in result.warnings)
    assert shown(result).mood == "warning"
    assert any(text.startswith("fat: measured minus predicted") for text in shown(result).notes)


@pytest.mark.slow
def test_the_joint_fit_uses_layers_and_finds_the_truth(truth, tmp_path):
    case = layered_case(tmp_path, truth)
    found = fit_joint(
        case, out=tmp_path / "out",
        options=FitOptions(contact_check=False, boundary_check=False, max_interval_solves=4),
    )  # fmt: skip
    assert found.data["n_layer_readings"] == 8
    assert found.data["c_kpa"] == pytest.approx(8.0, rel=0.01)
    assert found.data["m"] == pytest.approx(5.0, rel=0.05)  # four simulations beyond the first three
    assert found.data["chi_square"] < 0.1
    assert found.data["n_freedom"] == 4 + 1 + 8 - 3
    with found.path("levels_p1").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["quantity"] for row in rows} == {"depth_mm", "speed_m_per_s", "skin_mm", "fat_mm"}


def test_the_figure_shows_every_layer():
    shown = layers_figure(
        np.array([0.0, 4.0]), ("skin", "fat"), np.array([[1.5, 6.0], [1.4, np.nan]]),
        np.array([[1.5, 6.0], [1.4, 4.8]]), 0.2,
    )  # fmt: skip
    left, right = shown.axes
    named = [each.get_text() for each in left.get_legend().get_texts()]
    assert named[:2] == ["skin, predicted", "fat, predicted"]
    assert left.yaxis_inverted()
    assert len(right.lines) == 3
