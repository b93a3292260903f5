"""A run in which nothing is touched ends with force 0: it is said, and which mistake it looks like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.feb.log import read_log
from limbcli.feb.outline import read_outline
from limbcli.feb.write import write_feb
from limbcli.fem.motion.rigid import BodyState
from limbcli.model import LimbModel, LogRecord, Mesh, Surface
from limbcli.progress import SILENT
from limbcli.solvers.febio import _say_untouched
from limbcli.solvers.reference import ReferenceSolver
from limbcli.solvers.solver import LOG_FILE
from limbcli.solvers.untouched import without_force
from tests.fem.small_models import punch

FIELDS = ("x", "y", "z", "Fx", "Fy", "Fz")


def plate(kind: str = "tet4") -> LimbModel:
    """A punch that is pressed 1 mm in, and logged."""
    model = punch(kind, (2, 2, 2), levels=1)
    return replace(model, records=(LogRecord("rigid_body", FIELDS, "body.csv", "probe"),))


def turned(model: LimbModel, name: str) -> LimbModel:
    order = {"quad4": [0, 3, 2, 1], "tri3": [0, 2, 1], "tri6": [0, 2, 1, 5, 4, 3]}
    before = model.mesh.surfaces[name].facets
    facets = {kind: np.ascontiguousarray(each[:, order[kind]]) for kind, each in before.items()}
    mesh = model.mesh
    surfaces = {**mesh.surfaces, name: Surface(name, facets)}
    return model.with_mesh(Mesh(mesh.points, mesh.blocks, mesh.node_sets, surfaces))


def with_radius(model: LimbModel, radius: float) -> LimbModel:
    return replace(model, contacts=(replace(model.contacts[0], search_radius=radius),))


def away(model: LimbModel) -> LimbModel:
    drives = tuple(replace(each, value=-each.value) if each.value else each for each in model.drives)
    return replace(model, drives=drives)


MISTAKES: dict[str, tuple[Callable[[LimbModel], LimbModel], str]] = {
    "primary turned over": (lambda model: turned(model, "contact"), "'contact' look turned over"),
    "secondary turned over": (lambda model: turned(model, "face"), "'face' look turned over"),
    "both turned over": (
        lambda model: turned(turned(model, "face"), "contact"), "'contact' and 'face' look turned over"
    ),
    "beyond the radius": (lambda model: with_radius(model, 0.01), "beyond its search_radius of 0.01 mm"),
    "moves away": (away, "do not meet"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
@pytest.mark.parametrize("mistake", list(MISTAKES))
def test_what_is_wrong_with_a_contact_without_force_is_said(tmp_path: Path, mistake: str, kind: str) -> None:
    change, words = MISTAKES[mistake]
    feb = write_feb(change(plate(kind)), tmp_path / "model.feb")
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    found = solver.read(feb)
    assert not found.probe_force().any()
    (warning,) = (each for each in found.warnings if "nothing was touched" in each)
    assert words in warning

    # the same from the records alone, as after a run of FEBio
    log = tmp_path / LOG_FILE
    before = len(read_log(log).warnings)
    _say_untouched(feb, read_outline(feb), log, SILENT)
    assert read_log(log).warnings[before:] == (warning,)


def test_a_contact_that_touches_is_not_spoken_of(tmp_path: Path) -> None:
    feb = write_feb(plate(), tmp_path / "model.feb")
    solver = ReferenceSolver(threads=1)
    solver.run(feb, progress=SILENT)
    assert solver.read(feb).probe_force().max() > 0
    text = (tmp_path / LOG_FILE).read_text()
    _say_untouched(feb, read_outline(feb), tmp_path / LOG_FILE, SILENT)
    assert (tmp_path / LOG_FILE).read_text() == text
    assert "nothing was touched" not in text


def test_surfaces_that_overlap_as_they_should_are_not_called_turned_over() -> None:
    """Without force nevertheless: a penalty of 0, or a record of one component only."""
    pressed_in = BodyState(np.array([0.0, 0.0, -0.5]), np.zeros(3))
    (sentence,) = without_force(plate(), [{"probe": pressed_in}])
    assert "check that its penalty is above 0" in sentence
    assert "turned over" not in sentence


def test_a_rigid_primary_surface_is_named() -> None:
    model = plate()
    (contact,) = model.contacts
    exchanged = replace(contact, primary=contact.secondary, secondary=contact.primary)
    (sentence,) = without_force(replace(model, contacts=(exchanged,)), [])
    assert "Make the soft surface the primary one" in sentence
