"""A cohort from table to page; its tissue against the truth, made by solves on another mesh."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from limbcli.cli.app import main
from limbcli.cohorts.column_checks import checked_cohort
from limbcli.cohorts.compliance import _person_share, _Slab
from limbcli.cohorts.estimate import estimate_sites, noise_of
from limbcli.cohorts.population import PRIOR_DEVIATION, START, CohortModel, reading_noise, readings
from limbcli.cohorts.result import holm, natural, person_scores
from limbcli.errors import CaseError, MeasurementError
from limbcli.inference.layered_family import FILE, HIGH, LOW, is_inside, layered_family, read_solved
from limbcli.inference.population import row_modes
from limbcli.stages.cohort import _refuse_foreign, cohort, read_cohort
from tests.benchmarks.cohort_structure import SHAPES, STRUCTURES, Structure, strains_and_force
from tests.benchmarks.layered_member import Member, solve_member
from tests.cohort_rows import people, written

MEAN = np.log([0.006, 0.010, 4.0])
SPREAD = np.diag([0.35, 0.3, 0.2]) ** 2


@pytest.fixture(scope="module")
def twelve(tmp_path_factory):
    """Twelve people's table, truth, and what the command left."""
    folder = tmp_path_factory.mktemp("cohort")
    rows, theta = people(12, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(7))
    table = written(folder / "people.csv", rows)
    result = cohort(table, out=folder / "out")
    return theta, folder / "out", result


def test_nothing_of_a_left_out_person_enters_the_slab(tmp_path):
    """Not by the noise of the marks either, which a layer that grows makes larger."""
    rows, _ = people(24, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(7), noise_mm=0.4)
    reported, _ = checked_cohort(written(tmp_path / "t.csv", rows))
    train = np.arange(24) > 0
    shortened = reported.shortened.copy()
    shortened[0, 0] = -1.0
    other = replace(reported, shortened=shortened, slope=reported.slope * np.where(train, 1.0, 2.0))
    assert not np.allclose(noise_of(other).layers.shortened, noise_of(reported).layers.shortened)
    answers = [_Slab(each, layered_family())(train) for each in (reported, other)]
    np.testing.assert_array_equal(*answers)


def test_twelve_rows_end_in_a_page_a_table_and_a_json(twelve):
    _, out, result = twelve
    data = json.loads((out / "cohort.json").read_text())
    assert (data["n_rows"], data["n_people"]) == (12, 12)
    found = data["compliance_left_out"]
    off = [each["difference_percent"] for each in found["rows"]]
    assert found["mean_absolute_difference_percent"] == pytest.approx(np.mean(off))
    low, high = found["interval_95_percent"]
    assert low < np.mean(off) < high
    worst = found["largest_row"]
    assert worst["difference_percent"] == max(off)
    assert worst["share_of_the_mean_percent"] == pytest.approx(max(off) / 12)
    assert sorted(set(found["folds"].values())) == list(range(10))
    for each in found["rows"]:
        assert each["fold"] == found["folds"][each["subject"]]
        ratio = each["predicted_mm_per_mpa"] / each["measured_mm_per_mpa"]
        assert each["difference_percent"] == pytest.approx(100 * abs(ratio - 1))
    with (out / "rows.csv").open() as stream:
        assert [row["subject"] for row in csv.DictReader(stream)] == [f"P{k:03d}" for k in range(12)]
    page = (out / "cohort.html").read_text()
    assert page.count("data:image") == 4
    assert "Who stands out?" in page
    assert re.findall(r"<h(\d)", page) == ["1", *("2" for _ in range(6))], "no level of headings is left out"
    assert f"between {low:.1f} and {high:.1f} % (95 %)" in page
    assert {each.suffix for each in (out / "pictures").iterdir()} == {".png", ".svg", ".csv"}
    assert result.summary[1] == "12 rows of 12 people"
    assert result.summary[0].startswith("Fat's stiffness cannot be had from these data")
    first = page.index("stiffness cannot be had from these data")
    assert first < page.index('<section class="reportlet')
    assert all(first < found.start() for found in re.finditer('class="box', page)), "before all warnings"
    assert json.loads((out / "cohort.json").read_text())["fat_stiffness"]["determined"] is False


def test_twelve_people_are_found_where_they_are(twelve):
    theta, out, _ = twelve
    data = json.loads((out / "cohort.json").read_text())
    truth = natural(theta.copy())
    for j, key in enumerate(("c_muscle_kpa", "c_fat_kpa", "m")):
        inside = [
            row[f"{key}_low"] <= truth[k, j] <= row[f"{key}_high"] for k, row in enumerate(data["rows"])
        ]
        assert sum(inside) >= 10, key  # of 12 at 95 %: fewer than 10 has a probability of 2 %
    own = data["sites"]["LL_P"]["population"]
    assert own["c_muscle_kpa"]["low"] < 6.0 < own["c_muscle_kpa"]["high"]
    assert own["m"]["mean_shrinkage"] > own["c_muscle_kpa"]["mean_shrinkage"]


@pytest.mark.slow
def test_few_people_have_no_folds_and_all_else(tmp_path):
    rows, _ = people(7, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(8))
    result = cohort(written(tmp_path / "t.csv", rows), out=tmp_path / "out")
    found = result.data["compliance_left_out"]
    assert found["mean_absolute_difference_percent"] is None
    assert "7 people are too few for 10 folds" in found["reason"]
    assert any("too few" in each for each in result.warnings)
    assert len(result.data["rows"]) == 7
    own = result.data["sites"]["LL_P"]["population"]
    for key, factor in (("c_muscle_kpa", 2.0), ("c_fat_kpa", 3.0), ("m", 3.0)):
        found = own[key]  # of seven people: the middle is known within a factor, not within decades
        assert (
            found["geometric_mean"] / factor < found["low"] < found["high"] < factor * found["geometric_mean"]
        )
        assert found["spread_of_ln_high"] < 1.5
    several = [{**row, "trial": str(k)} for k in range(2) for row in rows[:4]]
    for few in (rows[:4], several):
        with pytest.raises(MeasurementError, match="no site has complete rows of 5 people"):
            cohort(written(tmp_path / "few.csv", few), out=tmp_path / "out2")


def test_trials_of_the_same_people_do_not_narrow_the_population(tmp_path):
    rows, _ = people(6, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(8))
    several = [{**row, "trial": str(k)} for k in range(3) for row in rows]
    errors = []
    for each in (rows, several):
        table, _ = checked_cohort(written(tmp_path / "t.csv", each))
        (site,) = estimate_sites(table, layered_family(), noise_of(table))
        errors.append(site.population.mean_error)
    assert errors[1][0] > 0.7 * errors[0][0]  # as independent rows it would be 0.58 of it


@pytest.mark.slow
def test_a_table_in_another_order_is_the_same_table(tmp_path):
    rows, _ = people(9, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(8))
    several = [{**row, "trial": str(k)} for k in range(2) for row in rows]
    found = []
    for order in (range(18), np.random.default_rng(7).permutation(18)):
        table, _ = checked_cohort(written(tmp_path / "t.csv", [several[k] for k in order]))
        (site,) = estimate_sites(table, layered_family(), noise_of(table))
        back = np.lexsort((table.trial[site.rows].astype(str), table.person[site.rows].astype(str)))
        found.append((site.population.mean, site.found.low[back], site.found.effective[back]))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("n_trials", [1, 3])
def test_what_a_persons_sites_have_in_common_is_not_what_its_trials_have(tmp_path, n_trials):
    rng = np.random.default_rng(7)
    rows, _ = people(60, mean=MEAN, spread=SPREAD, rng=rng)
    own = {row["subject"]: rng.standard_normal() for row in rows}
    several = [
        {**row, "location": site, "trial": str(k)}
        for site in ("LL_A", "LL_P") for row in rows for k in range(n_trials)
    ]  # fmt: skip
    table, _ = checked_cohort(written(tmp_path / "t.csv", several))
    of_site = {key: rng.standard_normal() for key in zip(table.person, table.site, strict=True)}
    common = np.array([own[each] for each in table.person])
    apart = np.array([of_site[key] for key in zip(table.person, table.site, strict=True)])
    # Sixty pairs tell a correlation of 0.5 to 0.1.
    assert _person_share(table, common + apart) == pytest.approx(0.5, abs=0.3)
    assert _person_share(table, apart) == pytest.approx(0.0, abs=0.4)
    assert _person_share(table.rows(table.site == "LL_A"), apart[table.site == "LL_A"]) is None


@pytest.mark.parametrize("alike", [0.0, 0.5])
def test_nobody_stands_out_where_all_are_alike_however_many_sites_each_has(alike):
    rng = np.random.default_rng(7)
    counts = [4] * 20 + [3] * 3 + [2] * 3 + [1] * 3
    n_counted = 0
    for _ in range(400):
        own = np.sqrt(alike) * rng.standard_normal(len(counts))
        scores = [
            each + np.sqrt(1 - alike) * rng.standard_normal(n) for each, n in zip(own, counts, strict=True)
        ]
        n_counted += bool((holm(2 * norm.sf(np.abs(person_scores(scores)))) < 0.05).any())
    assert n_counted / 400 < 0.08  # 5 % and three deviations of the count
    scores[22] = scores[22] + 6.0
    z = person_scores(scores)
    assert np.argmax(np.abs(z)) == 22


def test_the_command_tells_bad_rows_and_leaves_nothing(tmp_path, capsys):
    rows, _ = people(6, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(9))
    rows[2]["thickness_mm"] = rows[4]["thickness_mm"] = "12"
    table = written(tmp_path / "t.csv", rows)
    with pytest.raises(SystemExit) as stop:
        main(["cohort", str(table), "--out", str(tmp_path / "out"), "--quiet"])
    assert stop.value.code == 3
    reported = capsys.readouterr().err
    assert "the layers add up to" in reported
    assert "limbcli check" not in reported, "there is no case"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("own", ["rows.csv", "pictures/holiday.png", "pictures", "cohort.json"])
def test_files_of_ones_own_are_not_replaced(tmp_path, own):
    rows, _ = people(5, mean=MEAN, spread=SPREAD, rng=np.random.default_rng(9))
    path = tmp_path / own
    path.parent.mkdir(exist_ok=True)
    table = written(path, rows)
    before = path.read_bytes()
    if own == "pictures/holiday.png":
        table = written(tmp_path / "people.csv", rows)
    with pytest.raises(CaseError, match="would be replaced"):
        cohort(table, out=tmp_path)
    assert path.read_bytes() == before


def test_what_a_cohort_left_may_be_replaced(twelve):
    _, out, _ = twelve
    _refuse_foreign(out, out.parent / "people.csv")


@pytest.mark.parametrize("name", ["rows.csv", "cohort.html"])
def test_a_set_of_two_runs_is_refused(twelve, tmp_path, name):
    """As a kill between two files leaves it."""
    out = shutil.copytree(twelve[1], tmp_path / "out")
    assert read_cohort(out).data["n_rows"] == 12
    (out / name).write_text((out / name).read_text() + " ")
    with pytest.raises(CaseError, match=f"{name} is not the file that `cohort` wrote together") as caught:
        read_cohort(out)
    assert caught.value.where == str(out / name)


def solves(mesh: str):
    """Rows of the file of solves, as numbers."""
    with FILE.open(newline="") as stream:
        return [
            {k: v if k == "mesh" else float(v) for k, v in row.items()}
            for row in csv.DictReader(stream)
            if row["mesh"] == mesh
        ]


def test_tissue_is_recovered_from_solves_on_another_mesh():
    """c_muscle within what mesh and emulator may do; c_fat too, which is read from the layers."""
    members: dict[float, list[dict]] = {}
    for each in solves("fine"):
        members.setdefault(each["member"], []).append(each)
    chosen = [each for each in members.values() if len(each) == 3]
    assert len(chosen) >= 3
    face, c = 500.0, 0.007
    root = np.sqrt(face)
    thickness, strain, force, slope, shortened, truth = [], [], [], [], [], []
    for rows in chosen:
        last = rows[-1]
        e = np.array([0.0, *(row["strain"] for row in rows)])
        f = np.array([0.0, *(row["force"] * row["strain"] for row in rows)]) * c * face
        whole, skin = last["thickness"] * root, last["skin"] * root
        fat = last["fat_share"] * (whole - skin)
        depth = e[-1] * whole
        at = np.linspace(0, e[-1], 400)
        fine = np.interp(at, e, f)
        thickness.append([skin, fat, whole - skin - fat])
        strain.append(e[-1])
        force.append(f[-1])
        slope.append(np.sum(fine * at) / np.sum(at * at) / whole / face)
        shortened.append(
            depth
            * np.array([1 - last["below_skin"], last["below_skin"] - last["below_fat"], last["below_fat"]])
        )
        truth.append(np.log([c, c * last["ratio"], last["m"]]))
    thickness, strain, shortened, truth = map(np.array, (thickness, strain, shortened, truth))
    family, faces = layered_family(), np.full(len(chosen), face)
    model = CohortModel.of(family, thickness, faces, strain)
    seen = readings(np.array(force), faces, thickness.sum(axis=1), shortened, np.array(slope))
    exact = np.full(3, 0.01)  # mm: these marks have no noise
    noise = reading_noise(shortened, exact, 0.05, family.error)
    found = row_modes(model, seen, noise, START, np.diag(PRIOR_DEVIATION**2))
    apart = found - truth
    keep = is_inside(model.shape)
    # A mesh and the emulator together: a quarter of c_muscle. c_fat is read from a part of the shortening;
    # of a thin slab with fat a sixth as stiff as muscle it says little and the prior decides: so the median.
    assert np.sqrt(np.mean(apart[keep, 0] ** 2)) < 0.25
    assert np.median(np.abs(apart[keep, 1])) < 0.4


@pytest.mark.slow
def test_a_member_of_the_file_is_solved_again():
    """The shallow strains of one small member, as the file has them: same mesh, same law, same solver."""
    rows = [row for row in solves("family") if row["member"] == 1]
    member = Member(*(rows[0][name] for name in ("thickness", "fat_share", "skin", "ratio", "m")))
    again = solve_member(member, strains=[row["strain"] for row in rows[:2]], gradients=False)
    # The file keeps six digits and its solves were converged to 1e-3 of the forces at play.
    assert again.force == pytest.approx([row["force"] for row in rows[:2]], rel=5e-3)
    assert again.below_fat == pytest.approx([row["below_fat"] for row in rows[:2]], rel=5e-3)


def test_the_file_fills_the_family():
    x = read_solved(FILE, "family").x
    reach = np.ptp(x, axis=0) / (HIGH - LOW)
    assert (reach[:5] > 0.85).all()
    assert (x[:, 5].min(), x[:, 5].max()) == pytest.approx((0.05, 0.4))


@pytest.mark.slow
def test_the_lower_leg_of_the_real_table(shared, tmp_path):
    path = shared / "data" / "multis" / "indentations.csv"
    if not path.is_file():
        pytest.skip("needs data/multis of the reference data")
    with path.open(newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["location"] in ("LL_A", "LL_P")]
    data = cohort(written(tmp_path / "legs.csv", rows), out=tmp_path / "out").data
    assert (data["n_rows"], data["n_people"]) == (187, 95)
    assert data["identification_processor_s_per_row"] < 0.5
    found = data["compliance_left_out"]
    assert found["mean_absolute_difference_percent"] < found["same_folds"]["sites_mean_percent"]
    assert found["repeatability"]["percent_from_trials"] is None
    assert found["repeatability"]["percent_from_marks_and_slope_alone"] < 10


@pytest.mark.slow
def test_what_a_table_does_not_tell_moves_fats_part_as_much_as_fat_four_times_as_stiff():
    """Why c_fat is not fat's stiffness: sliding muscle, stiff skin and fascia do what stiff fat does."""
    shape, _ = SHAPES["thin, 0.38"]
    bonded, _ = strains_and_force(Member(*shape, 1.0, 2.0), Structure())
    stiff_fat, _ = strains_and_force(Member(*shape, 4.0, 2.0), Structure())
    untold, _ = strains_and_force(Member(*shape, 1.0, 2.0), STRUCTURES["sliding, stiff skin, fascia"])
    assert bonded > 0.9
    assert untold < stiff_fat < 0.7
