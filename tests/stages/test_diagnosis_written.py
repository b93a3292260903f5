"""The model that a diagnosis leaves, and what is told of its contact."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.effects.curves import Curves
from limbcli.stages.diagnosis import written_model as written

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
        assert f"about {takes} of the force at 12.0 mm" in reported


def test_nothing_is_told_where_the_contact_was_not_tried():
    mine = SimpleNamespace(curves=SimpleNamespace(penetration=None))
    assert written._contact_takes(mine, CURVES, CURVES.force, 12.0, 20.0, out=Path("out")) is None
