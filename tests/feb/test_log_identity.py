"""A log is taken for the model file beside it only with proof."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.errors import SolveError
from limbcli.feb.log_identity import check_belongs, marked, read_echo
from limbcli.feb.outline import read_outline

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"
ECHO = """
 MESH INFO
===========================================================================
	Number of materials ............................ : 2
	Number of nodes ................................ : {n_nodes}

 MATERIAL DATA
===========================================================================
  1 - tissue (type: Ogden unconstrained)
	density ........................................... : 1e-09
	cp ................................................ : 0.05
	c1 ................................................ : {c1}
	m1 ................................................ : 2
---------------------------------------------------------------------------
  2 - probe (type: rigid body)
	density ........................................... : 1e-09
	center_of_mass .................................... : 0,0,-0.05

 RIGID BODY DATA
===========================================================================
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "model.feb").write_text((DATA / "punch.feb").read_text())
    return tmp_path


def check(folder: Path, log: str, *, by_mark: bool = False) -> None:
    (folder / "model.log").write_text(log)
    feb = folder / "model.feb"
    check_belongs(folder / "model.log", feb, read_outline(feb), by_mark=by_mark)


def test_a_log_with_the_file_s_mark_passes_until_the_file_changes(folder: Path) -> None:
    log = f"\tPlot file  : {marked(folder / 'model.feb', '.xplt')}\n"
    check(folder, log, by_mark=True)
    text = (folder / "model.feb").read_text()
    (folder / "model.feb").write_text(text.replace("<c1>0.0025", "<c1>0.0026"))
    with pytest.raises(SolveError, match="another model file"):
        check(folder, log)


def n_nodes() -> int:
    return int((read_outline(DATA / "punch.feb").nodes >= 0).sum())


def test_a_log_without_a_mark_is_judged_by_the_input_it_repeats(folder: Path) -> None:
    good = ECHO.format(n_nodes=n_nodes(), c1="0.0025")
    assert read_echo(good.splitlines()).materials[1]["c1"] == 0.0025
    check(folder, good)
    with pytest.raises(SolveError, match=r"a different material: c1 is 0\.005, not 0\.0025"):
        check(folder, ECHO.format(n_nodes=n_nodes(), c1="0.005"))
    with pytest.raises(SolveError, match="nodes"):
        check(folder, ECHO.format(n_nodes=n_nodes() + 1, c1="0.0025"))
    with pytest.raises(SolveError, match="mark"):
        check(folder, good, by_mark=True)


def test_a_log_that_does_not_tell_is_refused(folder: Path) -> None:
    with pytest.raises(SolveError, match="does not state which model"):
        check(folder, "version 4.11.0\n")
