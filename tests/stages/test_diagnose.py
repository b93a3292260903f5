"""The whole stage on a small block: solved, diagnosed, written, and taken up again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects import EFFECTS as KNOWN
from limbcli.effects import effect
from limbcli.effects.own_file import effect_of_file
from limbcli.effects.reading import Protocol, Reading, read
from limbcli.errors import CaseError, FitError, LimbError, MeasurementError
from limbcli.feb.read import read_feb
from limbcli.model.npz_file import save_model
from limbcli.progress import SILENT
from limbcli.provenance.remaking_command import CommandStep
from limbcli.results import StageResult, open_stage
from limbcli.site_model.mesh_study import TissueLaw
from limbcli.stages.diagnose import DiagnoseOptions, _Diagnosed, chosen_effects, diagnose
from limbcli.stages.limb_field.site_force import force_reading
from tests.benchmarks.limb_twin import forces_of
from tests.case.test_case_text import two_sites
from tests.stages import block_case as block

EFFECTS = ("force-zero", "depth-zero", "contraction", "poroelasticity", "support-motion")
OWN = """
from dataclasses import replace
from limbcli.effects.effect import Effect, Parameter
SLIP = Parameter("slip_mm", null=0.0, start=0.2, low=0.0, high=2.0, typical=0.5)
def observe(reading, theta):
    return replace(reading, depth_zero=reading.depth_zero - theta["slip_mm"])
EFFECT = Effect("slip", "the probe slips", "measurement", "none", (SLIP,), observe=observe)
"""


def test_a_users_effect_is_one_file(tmp_path):
    path = tmp_path / "slip.py"
    path.write_text(OWN)
    assert effect_of_file(path, KNOWN).name == "slip"
    assert chosen_effects(DiagnoseOptions(effect_file=path, effects=("slip",)))[0].name == "slip"
    (tmp_path / "empty.py").write_text("x = 1")
    with pytest.raises(CaseError, match="defines no EFFECT"):
        effect_of_file(tmp_path / "empty.py", KNOWN)
    with pytest.raises(CaseError, match="there is no effect 'frction'"):
        chosen_effects(DiagnoseOptions(effects=("frction",)))


@pytest.mark.parametrize(
    ("there", "instead", "given"),
    [
        ("SLIP = ", "1 / 0\nSLIP = ", r"does not run \(ZeroDivisionError.*line 4"),
        ('theta["slip_mm"]', 'theta["slip"]', r"observe .* fails \(KeyError: 'slip'\).*line 6"),
        ("return replace", "replace", "returns NoneType, not a Reading"),
        ('Effect("slip"', 'Effect("tilt"', "there is an effect 'tilt' already"),
        ('"measurement"', '"numerical"', "its kind is 'numerical'"),
        ("low=0.0", "low=0.1", "null of slip_mm is 0, outside of its bounds"),
        ("typical=0.5", "typical=0.0", "typical of slip_mm is its null, 0"),
        ("slip_mm", "depth_zero_mm", "'depth-zero' has a parameter depth_zero_mm already"),
        (", observe=observe", "", "it changes nothing"),
        ("observe=observe", "observe=observe, needs=('forces',)", "it needs 'forces'"),
        ('theta["slip_mm"])', '0.3)', "its null value changes the reading"),
    ],
)  # fmt: skip
def test_an_effect_file_that_cannot_be_tried_is_told_as_the_users(tmp_path, there, instead, given):
    path = tmp_path / "slip.py"
    path.write_text(OWN.replace(there, instead))
    with pytest.raises(CaseError, match=f"(?s){given}"):
        effect_of_file(path, KNOWN)


def test_an_effect_file_may_hold_dataclasses(tmp_path):
    path = tmp_path / "slip.py"
    play = "from dataclasses import dataclass\n@dataclass\nclass Play:\n    mm: float | None = None\n"
    path.write_text(f"from __future__ import annotations\n{OWN}{play}")
    assert effect_of_file(path, KNOWN).name == "slip"


def test_a_users_effect_is_tried_beside_those_named_and_numerical_ones_cannot_be_named(tmp_path):
    path = tmp_path / "slip.py"
    path.write_text(OWN)
    chosen = chosen_effects(DiagnoseOptions(effect_file=path, effects=("force-zero",)))
    assert [each.name for each in chosen] == ["force-zero", "slip"]
    with pytest.raises(CaseError, match="'locking' cannot be selected"):
        chosen_effects(DiagnoseOptions(effects=("locking",)))


def test_an_effect_that_was_written_anew_is_solved_anew():
    """Kept simulations are told by what an effect makes of the model, not by its name and size alone."""
    simulations = SiteSimulations(block.block_model(counts=(4, 2, 2)), [1.0, 2.0], c=0.006)
    known, theta = effect("thickness"), {"thickness_change": 0.1}
    mended = replace(known, apply=lambda model, theta: known.apply(model, {"thickness_change": 0.2}))
    key = simulations.models.key(3.0, ((known, theta),))
    assert simulations.models.key(3.0, ((replace(known), dict(theta)),)) == key
    simulations.models._contents.clear()
    assert simulations.models.key(3.0, ((known, theta),)) == key
    simulations.models._contents.clear()
    assert simulations.models.key(3.0, ((mended, theta),)) != key


@pytest.mark.slow
def test_a_force_offset_on_the_block(tmp_path, rng):
    model = block.block_model("tet10", counts=(6, 4, 2))
    folder, out = tmp_path / "case", tmp_path / "out"
    folder.mkdir()
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid\nendsolid\n")
    toml = block.CASE_TOML.replace('"assumed"', '"spec"')
    toml = toml.replace('levels = "levels.csv"', 'levels = "levels.csv"\nfibre_direction = [0.0, 1.0, 0.0]')
    (folder / "case.toml").write_text(toml)
    depths = np.linspace(0, 4.0, 11)
    simulations = SiteSimulations(model, [0.7, 1.4, 2.1, 2.8, 3.5, 4.2], c=0.006)
    curves = simulations.curves(3.0)
    simulations.close()
    truth = read(curves, Protocol(np.zeros(11), depths, np.zeros(11)), Reading(force_zero=1.2))
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
    assert {"crop", "contact", "thickness"} <= {each["name"] for each in content["numerical"]}
    assert content["numerical"][0]["largest_change_in_deviations"] < 0.05  # a block without a cut
    assert content["shrink"][-1]["chi2_per_nu"] < content["shrink"][0]["chi2_per_nu"]
    assert read_feb(found.path("feb")).materials["tissue"].law == "ogden"
    assert found.data["n_solves"] > 0
    assert found.provenance["made_from"]["case"]["site/p1/fibres"]["direction"] == [0.0, 1.0, 0.0]
    (again,) = diagnose(case, out=out, options=options)
    assert again.data["n_solves"] == 0
    assert again.data["verdict"] == found.data["verdict"]
    assert replace(again, provenance={}, files=found.files).summary == found.summary
    sizes = content["sizes_95"]["force-zero"]["f0_n"]
    assert sizes[0] < 1.2 < sizes[1]
    alone = next(each for each in content["explanations"] if each["explanation"] == ["force-zero"])
    assert alone["fitted"]
    assert alone["values"]["force_zero_n"] == pytest.approx(1.2, abs=0.4)
    assert sum(each["probability"] for each in content["explanations"]) == pytest.approx(1.0, abs=0.01)
    low, high = content["f_kappa"]["interval_95"]
    assert content["f_kappa"]["prior_95"][0] <= low < 100.0
    assert high is None or high > 100.0
    assert all(each["f_kappa"]["interval_95"][0] > 0 for each in content["explanations"] if each["fitted"])
    assert "model: f-kappa" in {each["name"] for each in content["common_errors"]}
    assert found.path("sizes").is_file()
    told, values = content["tissue_force"], content["shrink"][-1]["values"]
    depths, c = np.array(told["depths_mm"]), 1e-3 * values["c_kpa"]
    tissue_force = force_reading({"tissue_force": told}, c_kpa=values["c_kpa"])
    for m in (
        values["m"],
        1.3 * values["m"],
    ):  # of a contact without penetration, which falls as 1/penalty^0.8
        soft, hard = (forces_of(model, depths, TissueLaw(c, 100.0, m), each) for each in (20.0, 80.0))
        given = np.exp(tissue_force.predict(np.log([c, m, 100.0]))[0])
        np.testing.assert_allclose(given, hard + 0.5 * (hard - soft), rtol=0.03)
    assert tissue_force.ratio(np.log([c, values["m"], 400.0])) == pytest.approx(
        1.0, abs=1e-3
    )  # f_kappa is open


def written(folder: Path, monkeypatch: pytest.MonkeyPatch, given: list[str], *sites: str) -> StageResult:
    """What is left of the first of these sites, which share a place."""
    stage = "limbcli.stages.diagnose."
    for name in ("gap_picture", "candidates_picture", "sizes_picture",
                 "sizes_of", "write_diagnosed", "all_levels_of"):  # fmt: skip
        monkeypatch.setattr(stage + name, lambda *_, **__: None)
    monkeypatch.setattr(stage + "_content", lambda *_: {"sentences": given, "sites": list(sites)})
    prepared = [
        SimpleNamespace(
            site=SimpleNamespace(name=name), notes=SimpleNamespace(warnings=[], data={}),
            simulations=SimpleNamespace(in_part={}, n_solves=0), interventions=[],
            curves=SimpleNamespace(changes=SimpleNamespace(not_simulated={}), site=None),
        )
        for name in sites
    ]  # fmt: skip
    forward_model = SimpleNamespace(not_simulated=set())
    case = SimpleNamespace(subject="B1")
    inputs = SimpleNamespace(into=lambda writer: None)
    run = _Diagnosed(
        case=case,
        sites=[each.site for each in prepared],
        out=folder,
        effects=(),
        options=DiagnoseOptions(),
        draining=None,
        progress=SILENT,
        inputs=inputs,
    )
    return run._write(None, forward_model, prepared, 0)


def test_the_command_prints_every_sentence_once(tmp_path, monkeypatch):
    """Also those of numerical doubt and of cycles, of which there may be a dozen together."""
    lines, of_cycles = [f"sentence {k}" for k in range(11)], ["All loadings follow one curve within noise."]
    monkeypatch.setattr("limbcli.stages.diagnose.note_earlier", lambda *_: None)
    monkeypatch.setattr("limbcli.stages.diagnose.cycle_facts", lambda *_: {"sentences": of_cycles})
    result = written(tmp_path, monkeypatch, lines, "p1")
    assert list(result.summary) == result.data["sentences"] == [*lines, *of_cycles]


def test_a_diagnosis_rests_on_all_sites_of_its_place_and_is_made_again_with_them(tmp_path, monkeypatch):
    noted: list[str] = []
    monkeypatch.setattr(
        "limbcli.stages.diagnose.note_earlier", lambda out, site, writer: noted.append(site.name)
    )
    monkeypatch.setattr("limbcli.stages.diagnose.cycle_facts", lambda *_: None)
    result = written(tmp_path, monkeypatch, [], "p1", "p2")
    assert noted == ["p1", "p2"]
    again = CommandStep.of(result).command(Path("limb"), Path("out"))
    assert again == "limbcli diagnose limb --site p1 --site p2 --out out"


def test_an_error_is_that_of_the_site_at_which_it_happened(tmp_path, monkeypatch):
    """Whatever its text names: here a file of p10 beside p1."""
    toml = two_sites(tmp_path / "case") / "case.toml"
    toml.write_text(toml.read_text().replace('name = "p2"', 'name = "p10"'))
    case = Case.open(toml.parent)

    def failing_at(name: str):
        def prepare(case, site, effects, **_):
            if site.name == name:
                raise MeasurementError("no levels", where="p10/levels.csv", fix="give them")
            return SimpleNamespace(simulations=SimpleNamespace(close=lambda: None), curves=None)

        return prepare

    def refuse(curves):
        raise FitError("no fit", where="p10/levels.csv", fix="none")

    monkeypatch.setattr("limbcli.stages.diagnose.check_earlier", lambda *_: None)
    monkeypatch.setattr("limbcli.stages.diagnose.places", lambda *_, **__: [case.sites])
    monkeypatch.setattr("limbcli.stages.diagnose.SiteForwardModel", refuse)
    for failing, site in (("p1", "p1"), ("p10", "p10"), ("none", "p1 + p10")):
        monkeypatch.setattr("limbcli.stages.diagnose.prepare", failing_at(failing))
        with pytest.raises(LimbError) as caught:
            diagnose(case, out=tmp_path / "out")
        assert (caught.value.site, caught.value.where) == (site, f"site {site}, p10/levels.csv")
        assert f"where: site {site}, p10/levels.csv" in str(caught.value)


def test_without_segment_it_says_so_and_leaves_nothing(tmp_path):
    case = block.make_case(
        tmp_path / "case", tmp_path / "made", np.array([1.0, 2.0]), np.array([1.0, 3.0]), c=0.006, build=False
    )
    with pytest.raises(CaseError, match="there is no result of `segment`"):
        diagnose(case, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
