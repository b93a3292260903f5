"""The whole stage on a small block: solved, diagnosed, written, and taken up again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.effects import effect
from limbcli.effects.reading import Protocol, Reading, read
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.model_io import save_model
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.stages.diagnose import DiagnoseOptions, chosen_effects, diagnose, load_effect
from limbcli.stages.diagnosis_curves import CurveBook
from limbcli.stages.diagnosis_numerics import USUAL_C
from limbcli.stages.diagnosis_prepare import prepare
from tests.stages import block_case as block

EFFECTS = ("force-zero", "depth-zero", "contraction", "poroelasticity", "support-motion")
OWN = """
from dataclasses import replace
from limbcli.effects.base import Effect, Parameter
SLIP = Parameter("slip_mm", null=0.0, start=0.2, low=0.0, high=2.0, typical=0.5)
def observe(reading, theta):
    return replace(reading, depth_zero=reading.depth_zero - theta["slip_mm"])
EFFECT = Effect("slip", "the probe slips", "measurement", "none", (SLIP,), observe=observe)
"""


def test_a_users_effect_is_one_file(tmp_path):
    path = tmp_path / "slip.py"
    path.write_text(OWN)
    assert load_effect(path).name == "slip"
    assert chosen_effects(DiagnoseOptions(effect_file=path, effects=("slip",)))[0].name == "slip"
    (tmp_path / "empty.py").write_text("x = 1")
    with pytest.raises(CaseError, match="holds no EFFECT"):
        load_effect(tmp_path / "empty.py")
    with pytest.raises(CaseError, match="there is no effect 'frction'"):
        chosen_effects(DiagnoseOptions(effects=("frction",)))


def test_an_effect_that_was_written_anew_is_solved_anew():
    """Kept simulations are told by what an effect makes of the model, not by its name and size alone."""
    book = CurveBook(block.block_model(counts=(4, 2, 2)), [1.0, 2.0], c=0.006)
    known, theta = effect("thickness"), {"thickness_change": 0.1}
    mended = replace(known, apply=lambda model, theta: known.apply(model, {"thickness_change": 0.2}))
    key = book._key(3.0, ((known, theta),))
    assert book._key(3.0, ((replace(known), dict(theta)),)) == key
    book._changed.clear()
    assert book._key(3.0, ((known, theta),)) == key
    book._changed.clear()
    assert book._key(3.0, ((mended, theta),)) != key


@pytest.mark.slow
def test_a_force_offset_on_the_block(tmp_path, rng):
    model = block.block_model("tet10", counts=(6, 4, 2))
    folder, out = tmp_path / "case", tmp_path / "out"
    folder.mkdir()
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid\nendsolid\n")
    toml = block.CASE_TOML.replace('"assumed"', '"spec"')
    (folder / "case.toml").write_text(toml)
    depths = np.linspace(0, 4.0, 11)
    book = CurveBook(model, [0.7, 1.4, 2.1, 2.8, 3.5, 4.2], c=0.006)
    curves = book.curves(3.0)
    book.close()
    truth = read(curves, Protocol(np.zeros(11), depths, np.zeros(11)), Reading(force_zero=0.4))
    speed = np.exp(truth.log_speed[:, 0]) * (1 + 0.05 * rng.standard_normal(11))
    force = truth.force + 0.05 * rng.standard_normal(11)
    shown = depths + np.r_[0.0, 0.1 * rng.standard_normal(10)]
    rows = [f"{f:.4f},{d:.4f},{v:.4f}" for f, d, v in zip(force, shown, speed, strict=True)]
    (folder / "levels.csv").write_text("force_n,depth_mm,swe_mean_m_per_s\n" + "\n".join(rows) + "\n")
    with open_stage(out, "mesh", subject="B1", site="p1") as writer:
        save_model(model, writer.file("model", "model.npz"))
    case = Case.open(folder)
    options = DiagnoseOptions(effects=EFFECTS)
    (found,) = diagnose(case, out=out, options=options)
    content = json.loads(found.path("diagnosis").read_text())
    assert ["force-zero"] in content["confidence_set"]
    assert {"poroelasticity", "support-motion"} <= set(content["not_evaluated"])
    assert {each["name"] for each in content["numerical"]} == {"crop", "contact", "f-kappa"}
    assert content["numerical"][0]["largest_change_in_deviations"] < 0.05  # a block without a cut
    assert content["shrink"][-1]["chi2_per_nu"] < content["shrink"][0]["chi2_per_nu"]
    assert read_feb(found.path("feb")).materials["tissue"].law == "ogden"
    assert found.data["n_solves"] > 0
    (again,) = diagnose(case, out=out, options=options)
    assert again.data["n_solves"] == 0
    assert again.data["verdict"] == found.data["verdict"]
    assert replace(again, provenance={}, files=found.files).summary == found.summary
    tied, softest = [], _softest(out)
    for factor in (1.0, 1.1):
        _leave_own_run(out, softest, factor=factor)
        tied.append(diagnose(case, out=out, options=options)[0].data)
    ratio = np.array(tied[1]["working_mesh_force_ratio"]) / np.array(tied[0]["working_mesh_force_ratio"])
    assert ratio == pytest.approx(1.1)
    simulated = []
    for factor in (1.0, 1.1):
        _leave_own_run(out, softest, factor=factor)
        ready = prepare(case, case.sites[0], {}, out=out, mesh=options.mesh, progress=SILENT)
        assert ready.curves.solve_node(2.0)
        simulated.append(ready.curves.curves(0.006, 2.0, (), {}, ()).force)
        ready.close()
    assert simulated[1][1:] == pytest.approx(1.1 * simulated[0][1:])


def _softest(out: Path) -> dict[str, np.ndarray]:
    """Of the curves solved so far, all at the diagnosis' own c."""
    paths = (out / "diagnose" / ".work-p1").glob("*.npz")
    curves = [dict(np.load(path)) for path in sorted(paths) if "cells" not in path.name]
    return min(curves, key=lambda each: each["force"][-1])


def _leave_own_run(out: Path, curve: dict[str, np.ndarray], *, factor: float) -> None:
    """A finished `build-feb` and `run` with a solved curve, times a factor."""
    with open_stage(out, "build-feb", subject="B1", site="p1") as writer:
        writer.data.update(f_kappa=100.0, m=2.0, element="tet10", c_kpa=1e3 * USUAL_C)
    rows = [f"{d},{d},{factor * f}" for d, f in zip(curve["depth"][1:], curve["force"][1:], strict=True)]
    with open_stage(out, "run", subject="B1", site="p1") as writer:
        writer.file("force_depth", "force-depth.csv").write_text(
            "time_s,depth_mm,force_n\n" + "\n".join(rows) + "\n"
        )


def test_without_segment_it_says_so_and_leaves_nothing(tmp_path):
    case = block.make_case(
        tmp_path / "case", tmp_path / "made", np.array([1.0, 2.0]), np.array([1.0, 3.0]), c=0.006, build=False
    )
    with pytest.raises(CaseError, match="there is no result of `segment`"):
        diagnose(case, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
