"""Records list nodes by place in the file and cells by id, as FEBio reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.progress import SILENT
from limbcli.solvers.record_tables import read_tables
from limbcli.solvers.reference import ReferenceSolver

FIRST_NODE, FIRST_CELL = 101, 41
CORNERS = ["0,0,0", "1,0,0", "1,1,0", "0,1,0", "0,0,1", "1,0,1", "1,1,1", "0,1,1"]


def cube(folder: Path, record: str, *, first_node: int = FIRST_NODE) -> Path:
    """A cube stretched by 0.1 mm along z, whose node and cell ids do not begin at 1."""
    ids = range(first_node, first_node + 8)
    nodes = "".join(f'<node id="{k}">{at}</node>' for k, at in zip(ids, CORNERS, strict=True))
    path = folder / "model.feb"
    path.write_text(
        f"""<febio_spec version="4.0"><Module type="solid"/>
<Control><time_steps>1</time_steps><step_size>1</step_size><solver/></Control>
<Material><material id="1" name="m" type="neo-Hookean"><E>1</E><v>0.3</v></material></Material>
<Mesh><Nodes name="all">{nodes}</Nodes>
<Elements type="hex8" name="cube"><elem id="{FIRST_CELL}">{",".join(map(str, ids))}</elem></Elements>
<NodeSet name="low">{",".join(map(str, ids[:4]))}</NodeSet>
<NodeSet name="top">{",".join(map(str, ids[4:]))}</NodeSet></Mesh>
<MeshDomains><SolidDomain name="cube" mat="m"/></MeshDomains>
<Boundary><bc type="zero displacement" node_set="low"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc>
<bc type="prescribed displacement" node_set="top"><dof>z</dof><value lc="1">0.1</value></bc></Boundary>
<LoadData><load_controller id="1" type="loadcurve"><points><pt>0,0</pt><pt>1,1</pt></points>
</load_controller></LoadData>
<Output><logfile>{record}</logfile></Output></febio_spec>"""
    )
    return path


SET = '<node_data data="uz" delim="," file="nodes.csv" node_set="top"/>'
LIST = '<node_data data="uz" delim="," file="nodes.csv">{}</node_data>'


@pytest.mark.parametrize("read", [read_feb, read_outline])
@pytest.mark.parametrize(
    ("listed", "words"),
    [
        ("105,106", "node 105 is the 5. in the file"),
        ("5,6", "no node is 5"),
        ("101", "node 101 is the 1. in the file"),
        ("2000", "no node is 2000"),
    ],
)
def test_a_list_that_febio_takes_for_other_nodes_is_refused(
    tmp_path: Path, read, listed: str, words: str
) -> None:
    with pytest.raises(CaseError, match=words) as caught:
        read(cube(tmp_path, LIST.format(listed)))
    assert "<NodeSet>" in caught.value.fix


@pytest.mark.parametrize("read", [read_feb, read_outline])
def test_a_list_of_places_that_are_ids_is_taken(tmp_path: Path, read) -> None:
    path = cube(tmp_path, LIST.format("5:8"), first_node=1)
    assert read(path).records[0].file == "nodes.csv"
    assert read_feb(path).records[0].items.tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize("read", [read_feb, read_outline])
def test_a_cell_that_is_not_there_is_refused_for_both_solvers(tmp_path: Path, read) -> None:
    record = f'<element_data data="J" file="j.csv">{FIRST_CELL},1</element_data>'
    with pytest.raises(CaseError, match="no element 1"):
        read(cube(tmp_path, record))


def test_febios_rows_are_places(tmp_path: Path) -> None:
    path = cube(tmp_path, SET)
    rows = "".join(f"{k},0.1\n" for k in (5, 6, 7, 8))
    (tmp_path / "nodes.csv").write_text(f"*Step  = 1\n*Time  = 1\n*Data  = uz\n{rows}")
    assert read_tables(read_outline(path), tmp_path).nodes["nodes.csv"].items.tolist() == [4, 5, 6, 7]


@pytest.mark.slow
def test_the_reference_solver_writes_the_same_rows_as_febio(tmp_path: Path) -> None:
    cells = f'<element_data data="J" file="j.csv">{FIRST_CELL}</element_data>'
    path = cube(tmp_path, SET + cells)
    solver = ReferenceSolver(threads=1)
    solver.run(path, progress=SILENT)
    last = (tmp_path / "nodes.csv").read_text().splitlines()[-4:]
    assert [line.split(",")[0] for line in last] == ["5", "6", "7", "8"]
    assert (tmp_path / "j.csv").read_text().splitlines()[-1].startswith(f"{FIRST_CELL},")
    found = solver.read(path)
    assert found.nodes["nodes.csv"].items.tolist() == [4, 5, 6, 7]
    np.testing.assert_allclose(found.nodes["nodes.csv"].values[-1], 0.1)
    assert found.elements["j.csv"].items.tolist() == [0]
