"""The model that a diagnosis leaves, and what is told of its contact."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.diagnosis import written_model as written
from limbcli.diagnosis.forward_model.surrogate import AtPoints
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA
from limbcli.effects import effect
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading
from limbcli.feb.read import read_feb
from limbcli.solvers.session import ReferenceSession
from tests.stages import block_case as block

CURVES = Curves(np.array([0.0, 6.0, 12.0]), np.array([0.0, 2.0, 8.0]), np.zeros((3, 0)), np.zeros(0))


class Sinks:
    """A probe that sinks in by as much as its penalty, of this mesh's, is short of 0.6."""

    def taken(self, curves: Curves, force: np.ndarray, deep: float, *, penalty: float) -> float:
        assert deep == 12.0
        return 0.6 - penalty


@pytest.mark.parametrize(("edge", "takes"), [(2.5, "10 %"), (5.0, "35 %"), (2.1, None)])
def test_a_contact_that_takes_of_the_force_is_told_by_its_own_mesh(monkeypatch, edge, takes):
    """The site's penalty is 20 on edges of `edge`, the working mesh's 80 on edges of 5 mm."""
    monkeypatch.setattr(
        written, "read_result", lambda *a, **k: SimpleNamespace(data={"size_under_probe_mm": edge})
    )
    mine = SimpleNamespace(
        curves=SimpleNamespace(penetration=Sinks()),
        site=SimpleNamespace(name="p1"),
        size=5.0,
        simulations=SimpleNamespace(model=SimpleNamespace(contacts=[SimpleNamespace(penalty=80.0)])),
    )
    reported = written._contact_takes(mine, CURVES, CURVES.force, 12.0, 20.0, out=Path("out"))
    if takes is None:
        assert reported is None
    else:
        assert "contact penalty of the site's model, 20" in reported
        assert f"the force at 12.0 mm by about {takes}" in reported


def test_nothing_is_told_where_the_contact_was_not_tried():
    mine = SimpleNamespace(curves=SimpleNamespace(penetration=None))
    assert written._contact_takes(mine, CURVES, CURVES.force, 12.0, 20.0, out=Path("out")) is None


@dataclass(frozen=True)
class Fitted:
    """A fit with these effects in it."""

    explanation: tuple[str, ...] = ()
    values: dict[str, float] = field(default_factory=lambda: {"c_kpa": 8.0, "m": 2.0})


@pytest.mark.slow
def test_on_a_bone_that_gives_way_the_probe_goes_to_the_depths_in_the_tissue(tmp_path):
    """To the depths alone, the force had been 15 to 17 % too low at 0.05 mm/N."""
    depths, theta = np.array([1.0, 2.0, 3.0]), {"support_compliance_mm_per_n": 0.05}
    force = block.true_curve("tet4", depths, c=0.008, f_kappa=F_KAPPA, m=2.0)
    case = block.make_case(tmp_path / "case", tmp_path / "out", depths, force, c=0.008)
    added = effect("support-motion")
    curves = Curves(np.r_[0.0, depths], np.r_[0.0, force], np.zeros((4, 0)), np.zeros(0))
    protocol = Protocol(np.r_[0.0, force], np.r_[0.0, depths], np.zeros(4))
    mine = SimpleNamespace(
        site=case.sites[0],
        curves=SimpleNamespace(site=SimpleNamespace(protocol=protocol), penetration=None),
        simulations=SimpleNamespace(c=0.008),
    )
    forward_model = SimpleNamespace(
        curves_of=lambda fitted, number: (curves, added.observe(Reading(), theta)),
        theta=lambda values, explanation, number: theta,
        model_of=lambda fitted: AtPoints(fitted.explanation, ({},)),
        effects={added.name: added},
    )
    found = SimpleNamespace(final=Fitted((added.name,)), estimates=Fitted(values={}))
    writer = SimpleNamespace(warnings=[], file=lambda kind, name: tmp_path / name)
    written.write_diagnosed(found, forward_model, mine, writer, out=tmp_path / "out", number=0)
    with ReferenceSession(read_feb(tmp_path / "diagnosed.feb"), threads=1) as session:
        assert session.solve().must_points.forces[-3:] == pytest.approx(force, rel=2e-3)
