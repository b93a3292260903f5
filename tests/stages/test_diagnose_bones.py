"""A bone that the surfaces have and the readings do not is found out."""

from __future__ import annotations

from pathlib import Path

import meshio
import pytest

from limbcli.case import Case
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import segment
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.synth import synth
from tests.benchmarks.small_case import write_case
from tests.stages.test_mesh import prism

QUICK = DiagnoseOptions(effects=("force-zero",), interventions=False, size=6.0)
MEASURED = SynthOptions(
    tissue=KnownTissue(c_kpa=8.0, f_kappa=100.0, m=4.0), size=6.0, element="tet10",
    protocol=LoadingProtocol(max_force=8.0, hold=1.0),
)  # fmt: skip


def add_bone(case: Path) -> None:
    """A rod of radius 3 mm along the limb, some 12 mm below the probe and beside its middle."""
    rod = prism(3.0, -70, 70, x=6.0, n=18)
    rod.points[:, 1] += 15.0
    meshio.Mesh(rod.points, [("triangle", rod.faces.astype("int32"))]).write(case / "fibula.ply")
    path = case / "case.toml"
    skin_and_tibia = path.read_text()
    path.write_text(skin_and_tibia.replace('tibia.ply"]', 'tibia.ply", "fibula.ply"]'))
    assert "fibula" in path.read_text()


@pytest.mark.slow
def test_a_bone_that_only_the_surfaces_have_is_left_out(tmp_path):
    """Measured on a limb with the large bone; brought with two."""
    limb = Case.open(write_case(tmp_path / "limb"))
    segment(limb, out=tmp_path / "truth")
    mesh(limb, out=tmp_path / "truth", size=6.0, far_size=14.0, element="tet10")
    brought = synth(limb, out=tmp_path / "truth", out_case=tmp_path / "brought", options=MEASURED).folder
    add_bone(brought)
    case = Case.open(brought)
    segment(case, out=tmp_path / "out")
    (found,) = diagnose(case, out=tmp_path / "out", options=QUICK)
    (tried,) = found.data["bones"]
    assert tried["left_out"] == ["bone_fibula"]
    assert tried["taken"]
    assert tried["deviance_gain"] > tried["gain_required"]
    assert found.data["sentences"][1].startswith("BONES: without bone_fibula")
    assert any(each.startswith("BONES") for each in found.warnings)
    assert found.data["verdict"] == "adequate"
    assert found.data["shrink"][0]["values"]["c_kpa"] == pytest.approx(8.0, rel=0.25)
