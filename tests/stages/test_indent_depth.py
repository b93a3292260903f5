"""Depths are those of the probe's lowest point, wherever a change has put its centre."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.effects import effect
from limbcli.feb.read import read_feb
from limbcli.fem.equilibrium.solve_times import step_times
from limbcli.model import Surface
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.progress import SILENT
from limbcli.shear_waves.pixels import Window
from limbcli.stages.simulated_subjects.hidden_effects import hide
from limbcli.stages.simulated_subjects.indent import KnownTissue, Press, _depth, indent
from tests.stages.block_case import block_model


def test_a_turned_probe_is_as_deep_as_its_lowest_edge(golden) -> None:
    model = read_feb(golden / "effect-base-tet4" / "model.feb")
    model = replace(model, bodies=(replace(model.bodies[0], center_of_mass=(0.0, 0.0, 0.0)),))
    turn = {"tilt_about_short_axis_deg": 7.0, "tilt_about_long_axis_deg": 0.0}
    tilted = effect("tilt").apply(model, turn)
    lift = tilted.bodies[0].center_of_mass[2]
    assert lift > 0.1
    pressed = SimpleNamespace(probe_depth=lambda body: np.array([3.0, 5.0]) - lift)
    assert _depth(tilted, pressed) == pytest.approx([3.0, 5.0])
    plain = SimpleNamespace(probe_depth=lambda body: np.array([3.0, 5.0]))
    assert _depth(model, plain) == pytest.approx([3.0, 5.0])


@pytest.mark.slow
def test_a_hidden_change_of_the_thickness_shows_in_the_skin_bone_distance() -> None:
    """The bone on the first B-mode frame is where the tissue that was pressed has it."""
    model = block_model()
    z = model.mesh.points[:, 2]
    base, top = np.flatnonzero(z < -15.999), model.mesh.surfaces["contact"]
    corners = [base[np.lexsort(model.mesh.points[base, :2].T)[[0, -1]]]]
    corners.append([base[np.argmin(model.mesh.points[base] @ [1, -1, 0])]])
    corners.append([base[np.argmax(model.mesh.points[base] @ [1, -1, 0])]])
    low, high, left, right = (int(each) for each in np.concatenate(corners))
    floor = Surface("bone", {"tri3": np.array([[low, high, left], [low, high, right]])})
    surfaces = {**model.mesh.surfaces, "skin": replace(top, name="skin"), "bone": floor}
    model = replace(model, mesh=replace(model.mesh, surfaces=surfaces))
    protocol = LoadingProtocol(step=0.5, max_force=1.0)
    found = [
        indent(
            Press(meshed=model, tissue=KnownTissue(), tolerance=1e-3, change=change),
            protocol=protocol,
            window=Window(depth_from=2.0, depth_to=10.0),
        ).skin_bone
        for change in (None, hide("thickness=0.1").in_model)
    ]
    assert found == pytest.approx([16.0, 17.6])


def test_friction_is_pressed_in_even_steps_and_resists() -> None:
    """A short step before a level would lose what friction had taken up."""
    protocol = LoadingProtocol(step=0.5, max_force=1.5)
    window = Window(depth_from=2.0, depth_to=10.0)
    free, rubbed = (
        indent(
            Press(meshed=block_model(), tissue=KnownTissue(), tolerance=1e-3, change=change),
            protocol=protocol,
            window=window,
        )
        for change in (None, hide("friction=0.5").in_model)
    )
    assert len(rubbed.depth) == len(free.depth) == 4
    assert (rubbed.depth[1:] < free.depth[1:]).all()
    press = Press(
        meshed=block_model(),
        tissue=KnownTissue(),
        tolerance=1e-3,
        progress=SILENT,
        change=hide("friction=0.5").in_model,
    )
    step = press._loaded(3.3).steps[0]
    times = np.diff([0.0, *step_times(step, every=True)])
    assert np.ptp(times) < 1e-9
    assert times.sum() == pytest.approx(step.n_steps * step.step_size)
