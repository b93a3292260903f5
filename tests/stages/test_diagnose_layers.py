"""`synth --with-layers`, then `diagnose`: layers on a limb in numbers, from reading to verdict."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.results import StageResult
from limbcli.site_model.site_levels import levels_of
from limbcli.stages.check import check
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from limbcli.stages.segment import segment
from limbcli.stages.simulated_subjects.hidden_effects import hide
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.synth_case import borders_at_rest
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.synth import synth, truth_file
from tests.stages.test_assumed_geometry import numbers

pytestmark = pytest.mark.usefixtures("coarse")
NAMES = ("adipose-layer", "force-zero", "depth-zero")


@pytest.fixture(scope="module")
def soft_fat(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A small limb in numbers, its skin and fat (6 mm) 3.3 times as soft as its muscle; a mesh of its own."""
    root = tmp_path_factory.mktemp("soft-fat")
    case = numbers(root / "case")
    case.file.write_text(case.file.read_text().replace("depth_mm = 0.05", "depth_mm = 0.05\nlayer_mm = 0.05"))
    plan = SynthOptions(
        tissue=KnownTissue(c_kpa=8.0, f_kappa=20.0, m=4.0), layers=True, size=3.5, far_size=8.0,
        element="tet10", protocol=LoadingProtocol(step=0.5, max_force=3.0, max_strain=0.4),
        hidden=(hide("adipose-layer=1.2"),),
    )  # fmt: skip
    synth(Case.open(case.folder), out=root / "base", out_case=root / "made", options=plan)
    file = root / "made" / "case.toml"
    kept = [line for line in file.read_text().splitlines() if not line.startswith(("trace", "swe_maps"))]
    file.write_text("\n".join(kept) + "\n")  # mean speeds only: it is the layers that tell
    return Case.open(root / "made")


@pytest.mark.slow
def test_layers_are_read_as_thick_as_the_geometry_tells_them(soft_fat):
    levels = levels_of(soft_fat.sites[0])
    noise = soft_fat.sites[0].noise.layer
    assert noise == 0.05
    first = {name: each[0] for name, each in levels.layers.items()}
    assert first["skin"] == pytest.approx(1.5, abs=4 * noise)
    assert first["fat"] == pytest.approx(4.5, abs=4 * noise)
    whole = sum(levels.layers.values())
    np.testing.assert_allclose(whole, levels.skin_bone, atol=1e-4)  # muscle goes down to the bone
    truth = tomllib.loads(truth_file(soft_fat.folder).read_text())["site"][0]
    np.testing.assert_allclose(levels.layers["fat"], truth["fat_mm"], atol=5 * noise)
    assert np.all(np.diff(truth["fat_mm"]) < 0)
    soft = 1 - truth["fat_mm"][-1] / truth["fat_mm"][0]
    assert soft > 1.2 * truth["depth_mm"][-1] / truth["skin_bone_mm"]  # more than its share
    assert not any(each.severity == "error" for each in check(soft_fat.folder).problems)


@pytest.mark.slow
def test_fat_is_named_by_its_layers_from_end_to_end(soft_fat, tmp_path):
    segment(soft_fat, out=tmp_path)
    options = DiagnoseOptions(effects=NAMES, interventions=False, size=4.0)
    found = diagnose(soft_fat, out=tmp_path, options=options)[0].data
    assert "layer" in found["channels"]
    assert found["verdict"] == "named"
    assert found["added"] == ["adipose-layer"]
    assert found["confidence_set"][0] == ["adipose-layer"]
    assert all("adipose-layer" in each for each in found["confidence_set"])
    first, last = (each["values"]["c_kpa"] for each in (found["shrink"][0], found["shrink"][-1]))
    assert abs(last - 8.0) < 0.5 * abs(first - 8.0)  # muscle's own, no longer that of both


def test_layers_need_a_geometry_that_tells_them():
    segmented = StageResult("segment", "N1", Path(), data={"layers": {"p1": {"skin_mm": 1.5, "fat_mm": 4.5}}})
    np.testing.assert_allclose(borders_at_rest(segmented, SimpleNamespace(name="p1")), [1.5, 6.0])
    with pytest.raises(CaseError, match="gives no thickness of skin and fat") as caught:
        borders_at_rest(segmented, SimpleNamespace(name="p2"))
    assert "--with-layers" in caught.value.fix
