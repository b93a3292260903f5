"""What a fit leaves for other programs."""

import json

from scipy.io import loadmat

from limbcli.fitting.exports import write_mat, write_mat_file
from limbcli.results import open_stage


def test_no_name_of_a_matlab_file_takes_the_place_of_another(tmp_path):
    content = {
        "stretch_around_plantarflexed_at_30": 1.1, "stretch_around_plantarflexed_at_60": 1.3,
        "states": {"bent-30": 1.0, "bent.30": 2.0, "30": 3.0},
    }  # fmt: skip
    write_mat(tmp_path / "fit.mat", content)
    found = loadmat(tmp_path / "fit.mat", simplify_cells=True)["fit"]
    assert found.pop("states") == {"bent_30": 1.0, "bent_30_2": 2.0, "x30": 3.0}
    assert found == {key: value for key, value in content.items() if key != "states"}


def test_fields_of_more_letters_than_matlab_has_stay_apart(tmp_path):
    write_mat(tmp_path / "fit.mat", {"a" * 70: 1.0, "a" * 80: 2.0})
    found = loadmat(tmp_path / "fit.mat", simplify_cells=True)["fit"]
    assert sorted(found.values()) == [1.0, 2.0]
    assert max(map(len, found)) == 63


def test_a_matlab_file_holds_what_the_result_does(tmp_path):
    with open_stage(tmp_path, "fit", subject="S1", site="p1") as writer:
        writer.data.update(m=4.0, asked={}, misfit={"poor": False, "words": ""}, cycle={"fitted": 2})
        write_mat_file(writer)
    data = json.loads((tmp_path / "fit" / "p1" / "fit.json").read_text())["data"]
    found = loadmat(tmp_path / "fit" / "p1" / "fit.mat", simplify_cells=True)["fit"]
    assert set(found) == set(data)
    assert found["cycle"] == data["cycle"]
