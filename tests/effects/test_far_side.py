"""What a limb's far side rests on: its stiff limit, and what of it enters a diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.curves.curve_plan import Solving
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects import far_side as module
from limbcli.effects.far_side import FAR_SIDE, far_side
from limbcli.model import LimbModel, Support, Surface
from tests.stages import block_case as block


def _hanging(bone_at: float) -> LimbModel:
    """The block held at its sides alone, with a facet of bone in the middle at this height (mm)."""
    model = block.block_model("tet4")
    points = model.mesh.points
    tissue = np.unique(model.mesh.solid_blocks[0].cells)
    level = tissue[np.abs(points[tissue, 2] - bone_at) < 1e-9]
    at = points[level, :2]
    corners = [level[np.abs(at - each).sum(axis=1).argmin()] for each in ((-24, -18), (24, -18), (0, 18))]
    sides = tissue[(np.abs(points[tissue, 0]) > 23.999) | (np.abs(points[tissue, 1]) > 17.999)]
    mesh = replace(
        model.mesh, node_sets={"fixed": sides},
        surfaces={**model.mesh.surfaces, "bone": Surface("bone", {"tri3": np.array([corners])})},
    )  # fmt: skip
    return replace(model, mesh=mesh, supports=(Support("fixed", ("x", "y", "z")),))


def test_the_far_side_lies_behind_the_bone(monkeypatch):
    monkeypatch.setattr(module, "BEYOND", 4.0)
    model = _hanging(-16.0 / 3)
    found = far_side(model)
    assert np.unique(model.mesh.points[found, 2]) == pytest.approx([-16.0, -32.0 / 3])
    assert not len(far_side(block.block_model("tet4")))  # a layer on a bench: nothing is behind it


def test_without_bone_on_the_beam_it_begins_behind_the_middle_of_the_tissue(monkeypatch):
    monkeypatch.setattr(module, "BEYOND", 4.0)
    model = _hanging(-16.0 / 3)
    away = {**model.mesh.surfaces, "bone": Surface("bone", {"tri3": np.zeros((0, 3), dtype=np.int64)})}
    found = far_side(replace(model, mesh=replace(model.mesh, surfaces=away)))
    assert np.unique(model.mesh.points[found, 2]) == pytest.approx([-16.0])


def test_held_tissue_does_not_move_and_bears_more(monkeypatch):
    monkeypatch.setattr(module, "BEYOND", 4.0)
    model = _hanging(-16.0 / 3)
    held = FAR_SIDE.apply(model, FAR_SIDE.start)
    assert FAR_SIDE.apply(model, FAR_SIDE.null) is model
    assert held.supports[-1].dofs == ("x", "y", "z")
    assert np.array_equal(held.mesh.node_sets[held.supports[-1].node_set], far_side(model))
    simulations = SiteSimulations(model, [1.0, 3.0], c=0.006, solving=Solving(tolerance=1e-5, threads=1))
    free, stiff = simulations.curves(4.0), simulations.curves(4.0, ((FAR_SIDE, FAR_SIDE.start),))
    simulations.close()
    assert np.all(stiff.force[1:] > 1.05 * free.force[1:])
