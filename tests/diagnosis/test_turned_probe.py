"""The probe turned by 90 degrees, simulated to propose a measurement."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from limbcli.diagnosis import prepare
from limbcli.diagnosis.curves.curve_plan import SiteWork
from limbcli.errors import SolveError


@pytest.mark.parametrize("usual", [[2000, 4000], []])
def test_a_proposal_takes_a_few_usual_solves_at_most(monkeypatch, usual):
    """A hard place, as over thin tissue, may take any time otherwise; what was simulated is closed."""
    closed = []
    turned = SimpleNamespace(work=SiteWork(), close=lambda: closed.append(True))
    monkeypatch.setattr(prepare, "Preparation", lambda *_: SimpleNamespace(simulated=lambda: turned))
    monkeypatch.setattr(prepare, "with_values", lambda site, **_: site)

    class Curves:
        changes = SimpleNamespace(m=5.0)

        def __init__(self, *_, **__):
            pass

        def solve_nodes(self, several):
            assert list(several) == [4.0, 8.0], "the nearest to the tissue's m first"
            assert turned.work.at_most == pytest.approx(3.0 * (3000 if usual else 500))
            raise SolveError("it takes too long", where="test", fix="none")

    monkeypatch.setattr(prepare, "SiteCurves", Curves)
    known = SimpleNamespace(
        site=None, effects={}, penetration=None, refused={}, nodes=[8.0, 4.0, 2.0], changes=Curves.changes
    )
    simulations = SimpleNamespace(work=SiteWork(usual=usual), model=None)
    prepared = SimpleNamespace(
        site=SimpleNamespace(name="p1", long_axis="transverse"),
        curves=known,
        simulations=simulations,
        size=5.0,
    )
    mesh, silent = prepare.WorkingMesh(), SimpleNamespace(event=lambda *_, **__: None)
    with pytest.raises(SolveError, match="too long"):
        prepare.turned_by_90(None, prepared, out=Path(), mesh=mesh, progress=silent)
    assert closed
