"""Record files of the reference solver: what is written, and how it is read back."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import punch

from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.model import LogRecord
from limbcli.progress import SILENT
from limbcli.solvers.reference import ReferenceSolver
from limbcli.solvers.solver import Simulation


def run(feb: Path) -> Simulation:
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    return solver.read(feb)


def test_several_records_of_one_body_are_one_table(tmp_path: Path) -> None:
    records = (
        LogRecord("rigid_body", ("z", "thx"), "place.csv", "probe"),
        LogRecord("rigid_body", ("Fz", "z"), "force.csv", "probe"),
    )
    model = replace(punch(n=(2, 2, 2), depth=0.5), records=records)
    found = run(write_feb(model, tmp_path / "model.feb"))
    assert found.rigid["probe"].fields == ("z", "thx", "Fz")
    assert found.probe_depth()[-1] == pytest.approx(0.5)
    written = read_records(tmp_path / "force.csv").values[:, 0, 0]
    np.testing.assert_array_equal(found.probe_force(), -written)


def test_nothing_reacts_before_the_first_step(tmp_path: Path) -> None:
    """The probe stands a little inside the tissue there; FEBio's files hold zeros."""
    record = LogRecord("rigid_body", ("z", "Fx", "Fy", "Fz", "Mx", "My", "Mz"), "body.csv", "probe")
    model = replace(punch(n=(2, 2, 2), depth=0.5), records=(record,))
    body = run(write_feb(model, tmp_path / "model.feb")).rigid["probe"].values
    assert body[0, 0, 0] == pytest.approx(-0.05)
    assert not body[0, 0, 1:].any()
    assert abs(body[-1, 0, 3]) > 1e-3


def test_a_rigid_cell_is_logged_where_it_began(tmp_path: Path) -> None:
    """So FEBio does, which never moves its integration points; it had stood at 0."""
    record = LogRecord("element", ("x", "y", "z", "J"), "cells.csv")
    model = replace(punch(n=(2, 2, 2), depth=0.5), records=(record,))
    cells = run(write_feb(model, tmp_path / "model.feb")).elements["cells.csv"].values
    np.testing.assert_allclose(cells[:, -1], [[6.0, 5.0, -0.05, 1.0]] * len(cells), atol=1e-12)
    assert (cells[-1, :-1, 2] < cells[0, :-1, 2]).all()  # the tissue goes down


def test_records_carry_places_of_nodes_and_ids_of_cells(tmp_path: Path) -> None:
    """As FEBio's do: here of nodes listed from the last id to the first, and of cells with ids from 101."""
    records = (
        LogRecord("node", ("x", "y", "z", "ux", "uy", "uz"), "nodes.csv"),
        LogRecord("element", ("J",), "cells.csv", np.array([3, 5])),
    )
    feb = write_feb(replace(punch(n=(1, 1, 1), depth=0.5), records=records), tmp_path / "model.feb")
    text = feb.read_text()
    nodes = re.findall(r"<node id=.*</node>", text)
    text = text.replace("\n".join(nodes), "\n".join(reversed(nodes)))
    text = re.sub(r'<elem id="(\d)">', r'<elem id="10\1">', text)
    feb.write_text(re.sub(r'(file="cells.csv"[^>]*>)4,6<', r"\g<1>104,106<", text))
    found = run(feb)
    written = read_records(tmp_path / "nodes.csv")
    rest = written.values[-1, :, :3] - written.values[-1, :, 3:]
    np.testing.assert_allclose(rest, read_feb(feb).mesh.points[written.ids - 1], atol=1e-9)
    assert written.ids.tolist() == list(range(1, len(nodes) + 1))
    nodes_read = found.nodes["nodes.csv"]
    rest = nodes_read.values[-1, :, :3] - nodes_read.values[-1, :, 3:]
    np.testing.assert_allclose(rest, read_feb(feb).mesh.points[nodes_read.items], atol=1e-9)
    assert read_records(tmp_path / "cells.csv").ids.tolist() == [104, 106]
    assert found.elements["cells.csv"].items.tolist() == [3, 5]


def test_stretches_and_principal_strains_follow_from_the_deformation_gradient(tmp_path: Path) -> None:
    """Tetrahedra have one integration point, so that their means are functions of the mean of F."""
    stretches = ("Ux", "Uy", "Uz", "Uxy", "Uyz", "Uxz", "U1", "U2", "U3")
    gradient = tuple(f"F{a}{b}" for a in "xyz" for b in "xyz")
    record = LogRecord("element", (*stretches, "E1", "E2", "E3", *gradient), "cells.csv")
    model = replace(punch(n=(1, 1, 1), depth=0.5), records=(record,))
    values = run(write_feb(model, tmp_path / "model.feb")).elements["cells.csv"].values[-1, :-1]
    F = values[:, 12:].reshape(-1, 3, 3)
    _, squares, right = np.linalg.svd(F)
    U = np.einsum("cai,ca,caj->cij", right, squares, right)
    entries = np.stack([U[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=1)
    assert abs(squares - 1).max() > 1e-3
    np.testing.assert_allclose(values[:, :6], entries, atol=1e-9)
    np.testing.assert_allclose(values[:, 6:9], squares, atol=1e-9)
    np.testing.assert_allclose(values[:, 9:12], (squares**2 - 1) / 2, atol=1e-9)


def test_a_bodys_record_carries_its_materials_id(tmp_path: Path) -> None:
    """In a file of one's own the rigid body may come first."""
    record = LogRecord("rigid_body", ("z", "Fz"), "body.csv", "probe")
    feb = write_feb(replace(punch(n=(1, 1, 1), depth=0.5), records=(record,)), tmp_path / "model.feb")
    text = feb.read_text()
    tissue, probe = re.findall(r"<material id=.*</material>", text)
    swapped = "\n".join([probe.replace('id="2"', 'id="1"'), tissue.replace('id="1"', 'id="2"')])
    text = text.replace(f"{tissue}\n{probe}", swapped)
    feb.write_text(re.sub(r'(name="probe">)2<', r"\g<1>1<", text))
    assert run(feb).probe_depth()[-1] == pytest.approx(0.5)
    assert read_records(tmp_path / "body.csv").ids.tolist() == [1]
