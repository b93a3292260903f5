"""The readings of a case's sites for the stiffness field, and the field in one call."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from limbcli.case.parts import StatedNoise
from limbcli.errors import CaseError, FitError, SolveError
from limbcli.files.atomic import sha256
from limbcli.measurement.elastography import SweMap, write_map
from limbcli.results import StageResult, StageWriter, open_stage, plain, write_sealed
from limbcli.stages.limb_field import limb_force
from limbcli.stages.limb_field.case_field import CaseField, case_field, cohort_priors
from limbcli.stages.limb_field.limb_force import as_on_limb, contradicting_forces, cut_warnings
from limbcli.stages.limb_field.site_force import force_reading
from limbcli.stages.limb_field.site_results import LimbReadings, of_diagnosis, of_fit, site_results
from limbcli.stiffness_field import LABELS, PARAMETERS, Interval, limb_coordinates, stiffness_field
from tests.stiffness_field import synthetic as limb

NOT_KEPT = Mock(spec=StageWriter)
FIT = {
    "c_kpa": 8.0, "m": 4.0, "f_kappa": 1000.0,
    "interval_95": {"c_kpa": [6.6, 9.7], "m": [3.0, 5.5], "f_kappa": [20.0, None]},
    "correlation": {"c,m": -0.6, "c,f_kappa": None, "f_kappa,m": None},
}  # fmt: skip
DIAGNOSED = {
    "added": ["tilt"],
    "shrink": [
        {"values": {"c_kpa": 8.0, "m": 4.0}, "intervals_95": {"c_kpa": [6.0, 9.0], "m": [3.0, 5.0]}},
        {"values": {"c_kpa": 12.0, "m": 3.0}, "intervals_95": {"c_kpa": [10.0, 14.0], "m": [2.0, None]}},
    ],
}
HEIGHT, ANGLE = 110.0, 0.0
NORMAL = np.array([0.0, -1.0, 0.0])
SKIN = limb.skin_radius(np.array(HEIGHT)) * NORMAL + HEIGHT * limb.AXIS


def result(stage: str, data: dict) -> StageResult:
    made = {"made_from": {"case": {"probe": {"length": 50.0}}}}
    return StageResult(stage, "S1", Path("out"), "p1", data=data, provenance=made)


def mesh() -> StageResult:
    pose = np.eye(4)  # x along the limb, z outward
    pose[:3, :3] = np.stack([limb.AXIS, np.cross(NORMAL, limb.AXIS), NORMAL], axis=1)
    pose[:3, 3] = SKIN
    frame = {
        "skin_point_mm": SKIN, "normal": NORMAL, "long_axis": limb.AXIS, "patient_from_model": pose,
    }  # fmt: skip
    return result("mesh", plain({"frame": frame, "checks": {"skin_bone_mm": 20.0}}))


class Results:
    """The results that are there, by stage."""

    def __init__(self, **there: StageResult):
        self.there = there

    def present(self, stage: str, *, site: str | None = None) -> StageResult | None:
        return self.there.get(stage)


def case_of(swe_maps: Path | None = None, levels: Path | None = None) -> SimpleNamespace:
    site = SimpleNamespace(
        name="p1", swe_maps=swe_maps, noise=StatedNoise(), density_kg_per_m3=1000.0, levels=levels
    )
    return SimpleNamespace(sites=[site], subject="S1")


def read(**there: StageResult):
    return site_results(case_of(), Results(mesh=mesh(), **there), NOT_KEPT)


def told_force() -> dict:
    """What a fit of 8 kPa says of its force: two depths, simulated with two tissues (f_kappa by m)."""
    f_kappa, m = np.array([100.0, 50.0]), np.array([2.0, 4.0])
    slopes = np.array([[[0.1, 0.2], [0.15, 0.3]]] * 2)  # of ln force by ln f_kappa, ln m
    logs = np.log([f_kappa / 100.0, m / 2.0]).T
    forces = np.array([1.0, 3.0]) * np.exp(np.einsum("kdp,kp->kd", slopes, logs))
    return plain(
        {
            "depths_mm": [2.0, 4.0], "fitted_n": forces[1], "noise_n": [0.1, 0.2], "c_share": [1.0, 0.9],
            "model_errors_of_ln": [[0.03, 0.03], [0.02, 0.05]],
            "simulated": {"f_kappa": f_kappa, "m": m, "forces_n": forces, "slopes_of_ln": slopes},
        }
    )  # fmt: skip


def test_a_fits_force_is_read_as_one_of_the_limb_half_way_to_free_cuts():
    """Free cuts take a fifth at the deepest level: half-way in logarithms the limb has sqrt(0.8) of the
    force, and needs a tissue that gives as much more in the site's model."""
    free = {"cut_free": {"depths_mm": [2.0, 4.0], "force_change_fraction": [-0.1, -0.2]}}
    told = told_force()
    found = force_reading({**FIT, "tissue_force": told, "boundary_check": free}, c_kpa=8.0)
    np.testing.assert_allclose(found.limb_over_site, [0.9**0.5, 0.8**0.5])
    stiffer = np.log([0.008 / 0.8 ** (0.5 / 0.9), 4.0, 50.0])  # of c, with its share of 0.9
    assert found.ratio(stiffer) == pytest.approx(1.0, rel=1e-4)
    held = force_reading({**FIT, "tissue_force": told}, c_kpa=8.0)
    np.testing.assert_allclose(held.limb_over_site, 1.0)
    assert force_reading(FIT, c_kpa=8.0) is None


def test_the_deepest_force_is_met_and_its_noise_widens_the_field():
    told = told_force()
    found = force_reading({**FIT, "tissue_force": told}, c_kpa=8.0)
    np.testing.assert_allclose(found.noise, [0.1, 0.01 * told["fitted_n"][1]])
    np.testing.assert_allclose(found.model_errors[:2], told["model_errors_of_ln"])
    np.testing.assert_allclose(found.model_errors[2], [0.0, 0.2 / told["fitted_n"][1]])


def test_a_tissues_force_is_that_of_the_fits_simulations():
    """At a simulated tissue and between two of them; c multiplies the force by its share."""
    told = told_force()
    found = force_reading({**FIT, "tissue_force": told}, c_kpa=8.0)
    at, slopes = found.predict(np.log([0.008, 4.0, 50.0]))
    np.testing.assert_allclose(np.exp(at), told["fitted_n"], rtol=1e-6)
    np.testing.assert_allclose(slopes, [[1.0, 0.2, 0.1], [0.9, 0.3, 0.15]], atol=1e-6)
    stiffer, _ = found.predict(np.log([0.016, 3.0, 70.0]))
    expected = np.log(2.0) * np.array([1.0, 0.9]) + np.log([1.0, 3.0])
    expected += np.log(0.7) * np.array([0.1, 0.15]) + np.log(1.5) * np.array([0.2, 0.3])
    np.testing.assert_allclose(stiffer, expected, atol=1e-4)


def test_the_force_of_a_diagnosis_is_read_beside_its_m_which_speeds_tell_too():
    """Its contact is hard; of a fit it is that of the fit's model, and m is told by the force alone."""
    fit, hard = {**FIT, "tissue_force": told_force()}, {**told_force(), "contact_penalty": 200.0}
    (site,) = read(fit=result("fit", fit)).sites
    assert site.force is not None
    assert (site.beside, site.force.contact_penalty) == (("c",), 20.0)
    (site,) = read(fit=result("fit", fit), diagnose=result("diagnose", DIAGNOSED)).sites
    assert site.force is None
    diagnosed = result("diagnose", {**DIAGNOSED, "tissue_force": hard})
    (site,) = read(fit=result("fit", fit), diagnose=diagnosed).sites
    assert (site.beside, site.force.contact_penalty) == (("c", "m"), 200.0)
    forces = np.exp(site.force.predict(np.log([0.012, 4.0, 50.0]))[0])
    np.testing.assert_allclose(forces, hard["fitted_n"], rtol=1e-6)


def test_a_diagnosed_tissue_gives_its_force_in_the_field_and_keeps_its_m():
    """12 kPa and m 3 are told; what is missing of the force is f_kappa's."""
    told = {**told_force(), "fitted_n": [0.9, 2.6]}
    diagnosed = result("diagnose", {**DIAGNOSED, "tissue_force": told})
    (site,) = read(diagnose=diagnosed).sites
    site = replace(site, values={**site.values, "m": Interval(3.0, 2.95, 3.05)})
    field = stiffness_field(limb_coordinates(limb.SKIN, limb.BONES, limb.AXIS, where="S1"), [site], [])
    c, m, f_kappa = (np.log(field.values_of(each, site.points).value).mean() for each in PARAMETERS)
    assert np.exp(m) == pytest.approx(3.0, rel=0.02)
    assert site.force.ratio(np.array([c, m, f_kappa])) == pytest.approx(1.0, abs=0.01)


def test_a_fit_gives_all_parameters_in_mpa_with_intervals_and_correlation():
    values, correlation, source = of_fit(FIT)
    assert values["c"].value == pytest.approx(0.008)
    assert (values["c"].low, values["c"].high) == (pytest.approx(0.0066), pytest.approx(0.0097))
    assert (values["f_kappa"].low, values["f_kappa"].high) == (20.0, None)  # above 20, not 1000
    assert correlation == {("c", "m"): pytest.approx(-0.588)}
    assert source == "fit"


def test_a_diagnosis_that_named_an_effect_goes_before_the_fit():
    (site,) = read(fit=result("fit", FIT), diagnose=result("diagnose", DIAGNOSED)).sites
    assert site.values["c"].value == pytest.approx(0.012)
    assert "tilt" in site.source
    assert "f_kappa" not in site.values


def test_a_diagnosis_that_named_nothing_leaves_the_fit():
    nothing = {**DIAGNOSED, "added": []}
    (site,) = read(fit=result("fit", FIT), diagnose=result("diagnose", nothing)).sites
    assert site.values["c"].value == pytest.approx(0.008)
    (alone,) = read(diagnose=result("diagnose", nothing)).sites
    assert alone.values["c"].value == pytest.approx(0.012)
    assert of_diagnosis(nothing)[2] == "diagnose (nothing missing)"


def test_a_site_without_results_says_why():
    assert site_results(case_of(), Results(), NOT_KEPT).left_out == {"p1": "it is not meshed"}
    assert "neither fitted nor diagnosed" in read().left_out["p1"]


def test_a_result_that_lacks_a_value_is_an_error_of_its_site():
    broken = {key: value for key, value in FIT.items() if key != "m"}
    with pytest.raises(FitError, match="lack a value") as caught:
        read(fit=result("fit", broken))
    assert "site p1" in str(caught.value)


@pytest.fixture
def two_sites():
    """A field through two sites of unlike tissue with forces."""
    tissues = {"p1": [0.008, 2.0, 60.0], "p2": [0.014, 6.0, 300.0]}
    sites = [
        limb.with_force(limb.site(name, limb.region(*where), tissue[0], 0.1), np.array(tissue), noise=0.01)
        for (name, tissue), where in zip(tissues.items(), [(60, 0), (160, 180)], strict=True)
    ]
    return CaseField(stiffness_field(limb.coordinates(), sites), LimbReadings(sites))


def answering(monkeypatch, less: float, *, stuck: str = "") -> list[str]:
    """A limb that gives this share of the force of the sites' models; returns the list of its simulations."""
    asked: list[str] = []

    def forces_of(found, name, depths, *, penalty, progress):
        asked.append(name)
        if name == stuck:
            raise SolveError("no equilibrium", where="limb", fix="none")
        (site,) = (each for each in found.field.sites if each.name == name)
        at = np.isin(site.force.depths, depths)
        return less * np.exp(site.force.predict(found.tissue_of(name))[0][at])

    monkeypatch.setattr(limb_force, "limb_forces", forces_of)
    return asked


@pytest.mark.slow
def test_the_fields_tissue_makes_up_for_what_the_limb_takes_from_a_sites_force(two_sites, monkeypatch):
    asked, warnings = answering(monkeypatch, 0.8), []
    found = as_on_limb(two_sites, lambda each: each, {"p1": "p1", "p2": "p2"}, warnings)
    for site in found.field.sites:
        alone = replace(site.force, limb_over_site=np.ones(2)).ratio(found.tissue_of(site.name))
        assert 0.8 * alone == pytest.approx(1.0, abs=0.01)
        assert found.force_on_limb[site.name] == pytest.approx(1.0, abs=0.01)
    assert len(asked) == 4  # once more to be sure
    assert not warnings


@pytest.mark.slow
def test_a_site_whose_force_cannot_be_simulated_on_the_limb_stays_and_is_told(two_sites, monkeypatch):
    asked, warnings = answering(monkeypatch, 0.8, stuck="p1"), []
    found = as_on_limb(two_sites, lambda each: each, {"p1": "p1", "p2": "p2"}, warnings)
    assert "site p1" in warnings[0]
    assert len(warnings) == 1
    assert set(found.force_on_limb) == {"p2"}
    assert found.field.sites[0].force is two_sites.field.sites[0].force
    assert asked.count("p1") == 1


def test_cuts_that_take_much_of_a_sites_force_are_told_unless_the_limbs_force_is_known(two_sites):
    assert not cut_warnings(two_sites)
    first, *others = two_sites.field.sites
    near = replace(first, force=replace(first.force, limb_over_site=np.array([0.9, 0.6])))
    found = replace(two_sites, field=replace(two_sites.field, sites=[near, *others]))
    (words,) = cut_warnings(found)
    assert "site p1: the force on the limb is taken as 60 %" in words
    assert not cut_warnings(replace(found, force_on_limb={"p1": 1.0}))


def test_a_force_that_the_fields_tissue_does_not_give_is_told(two_sites):
    assert not contradicting_forces(two_sites)
    first, *others = two_sites.field.sites
    other = replace(first, force=replace(first.force, fitted=2.0 * first.force.fitted))
    found = replace(two_sites, field=replace(two_sites.field, sites=[other, *others]))
    (words,) = contradicting_forces(found)
    assert "site p1: the field's tissue gives 50 % of the force" in words


@pytest.mark.slow
def test_a_limb_that_no_tissue_brings_to_a_sites_force_is_told(two_sites, monkeypatch):
    warnings: list[str] = []

    def half(found, name, depths, *, penalty, progress):
        (site,) = (each for each in found.field.sites if each.name == name)
        return 0.5 * site.force.fitted[np.isin(site.force.depths, depths)]

    monkeypatch.setattr(limb_force, "limb_forces", half)
    found = as_on_limb(two_sites, lambda each: each, {"p2": "p2"}, warnings)
    assert found.force_on_limb == {"p2": pytest.approx(0.5)}
    assert "site p2: the limb's force under the probe is 50 % of that found" in warnings[0]


LEVELS = "force_n,depth_mm\n0,0\n2,2\n4,4\n6,5\n"


@pytest.fixture
def measured(tmp_path):
    (tmp_path / "swe").mkdir()
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-15, 15.0), np.arange(2.0, 18)))
    for k in range(4):
        write_map(tmp_path / "swe" / f"level_{k:02d}.csv", SweMap(x, z, np.where(x > 0, 2.4, 1.8)))
    (tmp_path / "levels.csv").write_text(LEVELS, encoding="utf-8")
    return case_of(tmp_path / "swe", tmp_path / "levels.csv")


def test_a_map_at_rest_is_placed_on_the_limb_and_says_only_how_c_varies_where_c_is_known(measured):
    found = site_results(measured, Results(mesh=mesh(), fit=result("fit", FIT)), NOT_KEPT)
    (swe,) = found.maps
    assert swe.gain_deviation is None
    assert np.ptp(swe.points[:, 2]) > 20  # lateral runs along the limb
    assert (np.linalg.norm(swe.points[:, :2], axis=1) < limb.RADIUS).all()
    high = swe.points[:, 2] > HEIGHT + 4
    np.testing.assert_allclose(np.exp(swe.log_c[high]), 2e-6 * 1000 * 2.4**2, rtol=1e-6)
    bare = site_results(measured, Results(mesh=mesh()), NOT_KEPT).maps[0]
    assert bare.gain_deviation == pytest.approx(0.1)


def test_what_the_readings_are_made_from_is_recorded(measured, tmp_path):
    with open_stage(tmp_path / "out", "limb", subject="S1") as writer:
        site_results(measured, Results(mesh=mesh(), fit=result("fit", FIT)), writer)
    made = writer.result.provenance["made_from"]
    assert made["results"]["fit p1"]["data"]["interval_95"] == FIT["interval_95"]
    assert "frame" in made["results"]["mesh p1"]["data"]


def test_a_map_is_left_out_where_the_diagnosis_says_that_speeds_are_misread(measured):
    guided = result("diagnose", {**DIAGNOSED, "added": ["swe-guided-wave"]})
    found = site_results(measured, Results(mesh=mesh(), diagnose=guided), NOT_KEPT)
    assert not found.maps
    assert "swe-guided-wave" in found.left_out["map of p1"]


def test_the_field_of_a_case_in_one_call(measured):
    there = Results(mesh=mesh(), fit=result("fit", {**FIT, "tissue_force": told_force()}))
    found = case_field(
        measured, there, limb_coordinates(limb.SKIN, limb.BONES, limb.AXIS, where="S1"), NOT_KEPT
    )
    c, low, high, label, distance = found.element_columns(limb.region(HEIGHT, ANGLE))
    assert ((low < c) & (c < high)).all()
    assert np.exp(np.log(c).mean()) == pytest.approx(0.008, rel=0.05)
    assert {LABELS[int(each)] for each in label} <= {"identified", "interpolated"}
    assert distance.max() < 10
    words = json.loads(json.dumps(plain(found.to_json())))
    assert words["sites"]["p1"]["c_kpa"][0] == pytest.approx(8.0)
    assert words["sites"]["p1"]["force_of_field"] == pytest.approx(1.0, abs=0.02)
    assert words["sites"]["p1"]["limb_over_site"] == 1.0
    for name in ("c", "m", "f_kappa"):
        own = [each["probability"] for each in words["hypotheses"] if each["parameter"] == name]
        assert sum(own) == pytest.approx(1.0)
    assert words["held_out"]["n"] == 0


def population(geometric_mean, low, high, spread, beyond=None):
    return {
        "geometric_mean": geometric_mean, "low": low, "high": high, "spread_of_ln": spread,
        "spread_factor": np.exp(spread), "beyond_family": beyond,
    }  # fmt: skip


def write_cohort(folder: Path, sites: dict) -> Path:
    """A cohort's result as the command leaves it, with these locations."""
    folder.mkdir()
    hashes = {}
    for name in ("rows.csv", "cohort.html"):
        (folder / name).write_text(name, encoding="utf-8")
        hashes[name] = sha256(folder / name)
    content = {
        "table": "people.csv", "sites": sites, "warnings": [], "provenance": {"files_sha256": hashes},
        "fat_stiffness": {"words": "not identifiable"}, "n_rows": 12, "n_people": 12,
        "compliance_left_out": {"mean_absolute_difference_percent": None},
        "stands_out": {"rows": [], "people": []},
    }  # fmt: skip
    write_sealed(folder / "cohort.json", content)
    return folder


@pytest.fixture
def cohort(tmp_path):
    one = {
        "n_rows": 12, "n_people": 12,
        "population": {
            "c_muscle_kpa": population(5.0, 4.0, 6.25, 0.3), "c_fat_kpa": population(9.0, 6.0, 13.5, 0.3),
            "m": population(1.2, 1, 2, 0.3, "below 1.5"),
        },
    }  # fmt: skip
    return write_cohort(tmp_path / "people", {"LL_P": one, "LL_A": one})


def test_the_population_of_a_cohort_is_the_prior(cohort):
    found = cohort_priors(cohort, "LL_P")
    assert set(found) == {"c"}  # m lies beyond the family
    assert np.exp(found["c"].mean) == pytest.approx(0.005)
    assert found["c"].deviation == pytest.approx(np.hypot(0.3, np.log(6.25 / 4) / 3.92), rel=1e-3)
    with pytest.raises(CaseError, match="no location 'X'"):
        cohort_priors(cohort, "X")
    with pytest.raises(CaseError, match="several locations"):
        cohort_priors(cohort, None)
    with pytest.raises(CaseError, match="there is no result of `cohort`"):
        cohort_priors(cohort / "none", "LL_P")


def test_far_from_the_only_site_the_field_is_drawn_to_the_population(measured, cohort):
    """Of people with 5 kPa, at a limb whose site says 8 kPa: less than with the usual prior of 8 kPa."""
    there = Results(mesh=mesh(), fit=result("fit", FIT))
    given = (measured, there, limb_coordinates(limb.SKIN, limb.BONES, limb.AXIS, where="S1"), NOT_KEPT)
    usual, known = case_field(*given), case_field(*given, cohort=cohort, location="LL_P")
    far = limb.region(HEIGHT - 60.0, ANGLE + np.pi)
    drop = np.log(known.element_columns(far)[0] / usual.element_columns(far)[0])
    assert (drop < -0.01).all()
    assert known.to_json()["priors"]["c"]["source"] == "cohort, location LL_P, 12 people"
    assert known.to_json()["priors"]["m"]["source"] == usual.to_json()["priors"]["m"]["source"]
