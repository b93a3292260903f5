"""segment tells where a site can be, and check refuses sites that are nowhere."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.cli.app import main
from limbcli.errors import CaseError
from limbcli.imaging.dicom import read_series
from limbcli.imaging.nearest_skin import RoughSkin
from limbcli.meshing.sites_on_skin import MOVED_MM, place_fault
from limbcli.meshing.surfaces import read_surface
from limbcli.stages.check_geometry import geometry_findings
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import segment

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def segmented(tmp_path_factory):
    """A case of surfaces, one of its sites moved off the skin."""
    root = tmp_path_factory.mktemp("places")
    shutil.copytree(REPOSITORY / "cases" / "paper-parameters", root / "case")
    file = root / "case" / "case.toml"
    file.write_text(file.read_text().replace("[3.0, 36.0, 0.0]", "[3.0, 56.0, 0.0]", 1))
    case = Case.open(root / "case")
    return case, segment(case, out=root / "out"), root / "out"


def test_every_grid_point_is_a_place_where_a_site_can_be(segmented):
    _, result, out = segmented
    with result.path("site_grid_table").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) > 20
    assert len({row["name"] for row in rows}) == len(rows)
    skin = read_surface(out / "segment" / "skin.ply")
    for row in rows[::5]:
        place = np.array(json.loads(row["position_mm"]))
        fault = place_fault(skin, place)
        assert fault is None or fault.distance < MOVED_MM, row
    assert result.path("site_grid").read_bytes()[:4] == b"\x89PNG"


def test_angles_go_from_the_front_over_the_patients_left(segmented):
    _, result, _ = segmented
    with result.path("site_grid_table").open() as stream:
        ring = {row["angle_deg"]: row for row in csv.DictReader(stream) if row["name"].startswith("C")}
    assert float(ring["0"]["y_mm"]) < float(ring["180"]["y_mm"]), "anterior is -y"
    assert float(ring["90"]["x_mm"]) > float(ring["270"]["x_mm"]), "left is +x"


def test_site_off_the_skin_is_told_by_segment_and_refused_by_mesh(segmented):
    case, result, out = segmented
    (wrong,) = [each for each in result.data["site_problems"].values() if each["severity"] == "error"]
    assert "is the skin's nearest point" in wrong["what"]
    name = next(name for name, each in result.data["site_problems"].items() if each == wrong)
    with pytest.raises(CaseError, match="nearest point"):
        mesh(case, out=out, sites=[name])


def test_segment_command_ends_with_an_error_after_all_is_written(segmented, tmp_path, capsys):
    case, _, _ = segmented
    with pytest.raises(SystemExit) as stop:
        main(["segment", str(case.folder), "--out", str(tmp_path / "out"), "--quiet"])
    assert stop.value.code == 2
    assert (tmp_path / "out" / "segment" / "site-grid.png").is_file()
    shown = capsys.readouterr()
    assert "where a site can be: site-grid.png" in shown.out
    assert "position_mm = [" in shown.err


def test_check_of_images_alone_refuses_sites_outside_and_turned_ones():
    case = Case.open(REPOSITORY / "cases" / "phantom")
    image = read_series(case.imaging.mri).volume
    skin = RoughSkin(image)
    on = skin.points[len(skin.points) // 2]

    def problems_at(place: np.ndarray) -> list[tuple[str, str]]:
        site = replace(case.sites[0], marker=None, position=tuple(map(float, place)))
        found, _ = geometry_findings(replace(case, sites=(site,)), [])
        return [(each.what, each.fix) for each in found]

    assert problems_at(on) == []
    (outside,) = problems_at(on + np.array([500.0, 0.0, 0.0]))
    assert "nearest point" in outside[0]
    assert "position_mm = [" in outside[1]
    (turned,) = problems_at(on * np.array([-1, -1, 1]))
    assert "RAS, not LPS" in turned[0]
    assert str(round(float(on[0]), 1)) in turned[1]
