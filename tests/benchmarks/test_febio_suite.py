"""The rule by which files of FEBio's test suite are in scope, and the number that is compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from limbcli.feb.read import read_feb
from limbcli.fem.analysis import RunEnd
from limbcli.solvers.reference import prepare
from tests.benchmarks.febio_suite import Row, gold_values, kind_of, out_of_scope, solution_norm

PUNCH = Path(__file__).resolve().parents[1] / "data" / "feb" / "punch.feb"


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("", "", None),
        ('version="4.0"', 'version="2.0"', "format 2.0"),
        ("<analysis>STATIC", "<analysis>DYNAMIC", "analysis DYNAMIC"),
        ('type="Ogden unconstrained"', 'type="Fung orthotropic"', "material Fung orthotropic"),
        ("<Boundary>", '<Loads><surface_load type="pressure" surface="skin"/></Loads><Boundary>', None),
        ("<Boundary>", '<Loads><body_load type="centrifugal"/></Loads><Boundary>', "load centrifugal"),
        ('type="sliding-elastic"', 'type="sticky"', "contact sticky"),
        ("<two_pass>0", "<two_pass>1", "contact in two passes"),
        ("<primary>skin</primary><secondary>probe_face", "<primary>probe_face</primary><secondary>skin",
         "contact of two deformable sides"),
        ("<Boundary>", "<Discrete><x/></Discrete><Boundary>", "<Discrete>"),
    ],
)  # fmt: skip
def test_the_scope_follows_from_what_a_file_holds(old: str, new: str, why: str | None) -> None:
    text = PUNCH.read_text()
    assert old in text
    root = etree.fromstring(text.replace(old, new, 1).encode())
    assert out_of_scope(root) == ([] if why is None else [why])


def test_the_suites_values_are_the_last_of_each_row(tmp_path: Path) -> None:
    (tmp_path / "code").mkdir()
    rows = "'a1': ['Normal', 1, 2, 3, 4, 5, '2.5'],\n 'op1': ['', 0.1, 2, 3], 'b': ['', 1, 2, 3, 4, 5, '']"
    text = f"stdResults = {{{rows}}}"
    (tmp_path / "code" / "linuxGoldStandards.py").write_text(text)
    assert gold_values(tmp_path) == {"a1": 2.5}


def test_the_norm_is_that_of_the_free_displacements() -> None:
    analysis = prepare(read_feb(PUNCH), threads=1)
    last = analysis.run(end=RunEnd(last=1))[-1]
    assert solution_norm(analysis, last) == pytest.approx(np.linalg.norm(last.state.u[analysis.system.free]))
    analysis.close()


def test_a_value_that_is_none_does_not_agree() -> None:
    assert not Row("a", 1.0, True).agrees
    assert Row("a", 1.0, True, 1.0009).agrees
    assert not Row("a", 1.0, True, 1.002).agrees
    assert kind_of("line 12: <pressure> of 'map' 3.5; remove it") == "<pressure> of ... ..."
