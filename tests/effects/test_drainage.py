"""What drains, by superposition: exact where it must be, and in a site's readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.data.held_forces import STEP_S, HeldForces
from limbcli.effects import effect, poroelasticity
from limbcli.effects.curves import Curves
from limbcli.effects.drainage import SPREADS, Drainage, HeldIndentation
from limbcli.effects.reading import Protocol, Reading, read
from limbcli.errors import SolveError

CURVES = Curves(np.linspace(0, 10, 21), 0.4 * np.linspace(0, 10, 21) ** 1.5, np.zeros((21, 0)), np.zeros(0))
LEVELS = np.array([0.0, 2.0, 4.0, 6.0])
C, RAMP = 0.008, 0.02  # MPa, mm^2


def hold(depth: float, shares: np.ndarray, *, scale: float = 1.0) -> HeldIndentation:
    """A made one: pressed in linearly, and held."""
    at = np.concatenate([np.linspace(0.005, RAMP, 4), np.geomspace(0.03, 3000.0, 25)])
    memory = np.empty((len(at), len(SPREADS)))
    for k, x in enumerate(SPREADS):
        pressed = np.minimum(at, RAMP)
        memory[:, k] = x / RAMP * (np.exp(-(at - pressed) / x) - np.exp(-at / x))
    share = np.minimum(at / RAMP, 1.0)
    return HeldIndentation(depth, RAMP, at, scale * depth * (share - (share[:, None] - memory) @ shares))


def drainage() -> Drainage:
    shares = np.zeros((2, len(SPREADS)))
    shares[0, [1, 4]], shares[1, [1, 4, 6]] = (0.05, 0.1), (0.03, 0.08, 0.06)
    return Drainage.through([hold(8.0, shares[1], scale=3.0), hold(2.0, shares[0])])


def wet(k: float, table: Drainage) -> Reading:
    return poroelasticity.with_drainage(table).observe(Reading(c=C), poroelasticity.with_permeability(k))


def protocol(hold_s: float = 20.0) -> Protocol:
    return Protocol(np.zeros(4), LEVELS, np.full(4, hold_s))


def record() -> HeldForces:
    """The same staircase on the grid of a record."""
    depth = np.concatenate([np.full(80, 0.0), *(np.r_[np.linspace(d - 2, d, 5)[1:], np.full(80, d)]
                            for d in LEVELS[1:])])  # fmt: skip
    starts = [80 + 4 + 84 * k for k in range(3)]
    windows = np.array([[(a, a + 13), (a + 67, a + 80)] for a in starts])
    return HeldForces(depth, windows, np.zeros(3), 0.004**2 * np.eye(3))


def test_shares_are_those_of_the_holds():
    found = drainage()
    assert found.depth.tolist() == [2.0, 8.0]
    assert found.lost[0, [1, 4]] == pytest.approx([0.05, 0.1], abs=1e-9)
    assert found.lost[1, [1, 4, 6]] == pytest.approx([0.03, 0.08, 0.06], abs=1e-9)
    assert found.lost.sum(axis=1) == pytest.approx([0.15, 0.17], abs=1e-9)


def test_too_little_is_refused():
    with pytest.raises(SolveError, match="no held indentation"):
        Drainage.through([])
    short = hold(2.0, np.zeros(len(SPREADS)))
    with pytest.raises(SolveError, match="usable times"):
        Drainage.through([replace(short, spread=short.spread[:8], force=short.force[:8])])


def test_a_force_that_does_not_fall_as_drainage_does_is_refused():
    """A contact that slipped, say: the force grows in the hold."""
    made = hold(2.0, np.zeros(len(SPREADS)))
    grown = replace(made, force=made.force * np.where(made.spread > 10.0, 1.2, 1.0))
    with pytest.raises(SolveError, match="does not decay like that of draining tissue"):
        Drainage.through([grown])


def test_a_single_stray_step_does_not_count():
    made = hold(8.0, drainage().lost[1])
    stray = replace(made, force=made.force * np.where(np.arange(len(made.force)) == 15, 1.03, 1.0))
    assert Drainage.through([stray]).lost[0] == pytest.approx(drainage().lost[1], abs=1e-6)


def test_without_permeability_nothing_changes_and_a_little_changes_it_smoothly():
    table, null = drainage(), {poroelasticity.PERMEABILITY.name: 0.0}
    assert poroelasticity.with_drainage(table).observe(Reading(c=C), null) == Reading(c=C)
    plain = np.r_[read(CURVES, protocol(), Reading(c=C)).force, record().predict(CURVES, Reading(c=C))]

    def at(k: float) -> np.ndarray:
        reading = wet(k, table)
        return np.r_[read(CURVES, protocol(), reading).force, record().predict(CURVES, reading)]

    right, left = (at(1e-6) - plain) / 1e-6, (at(-1e-6) - plain) / -1e-6
    assert np.abs(right[1:]).min() > 1e-4
    assert left == pytest.approx(right, rel=1e-3, abs=1e-6)
    assert at(1e-3) - plain == pytest.approx(1e-3 * right, rel=0.01, abs=1e-9)


def test_a_held_level_is_the_simulated_hold():
    """One level at a simulated depth, reached at once: the hold's own relative force, at k c t."""
    table, k = drainage(), 60.0
    theirs = hold(8.0, table.lost[1])
    ramp_s, total_s = RAMP / (k * C), theirs.spread[20] / (k * C)
    one = Protocol(np.zeros(2), np.array([0.0, 8.0]), np.array([0.0, total_s - ramp_s]), ramp=ramp_s)
    found = read(CURVES, one, wet(k, table)).force[1] / read(CURVES, one, Reading()).force[1]
    assert found == pytest.approx(theirs.force[20] / 8.0, rel=1e-9)


def test_levels_and_record_tell_the_same_force():
    """At the ends of the holds, of the protocol and of the record that goes with it."""
    table, k = drainage(), 60.0
    reading, given = wet(k, table), record()
    levels = read(
        CURVES, Protocol(np.zeros(4), LEVELS, np.full(4, 80 * STEP_S), ramp=4 * STEP_S), reading
    ).force
    ends = np.array([[(a - 1, a), (b - 1, b)] for a, b in ((164, 248), (248, 332))])
    fall = replace(given, windows=ends).predict(CURVES, reading)
    assert fall == pytest.approx(np.log(levels[1:-1] / levels[2:]), abs=2e-3)


def test_only_the_product_of_permeability_and_stiffness_matters():
    table = drainage()
    one = poroelasticity.with_drainage(table)
    soft = one.observe(Reading(c=0.004), poroelasticity.with_permeability(30.0))
    stiff = one.observe(Reading(c=0.012), poroelasticity.with_permeability(10.0))
    assert record().predict(CURVES, soft) == pytest.approx(record().predict(CURVES, stiff), rel=1e-12)


def test_the_written_tissue_is_wet_and_its_cut_is_open():
    from tests.stages.block_case import block_model

    base = block_model(counts=(4, 2, 2))
    sides = {**base.mesh.node_sets, "cut": base.mesh.node_sets["fixed"][:5]}
    base = base.with_mesh(replace(base.mesh, node_sets=sides))
    model = effect("poroelasticity").apply(base, poroelasticity.with_permeability(20.0))
    assert model.materials["tissue"].law == "biphasic"
    assert model.materials["tissue"].parameters["perm"] == pytest.approx(20.0)
    assert model.materials["tissue"].parts[0].parameters["kappa"] == pytest.approx(2.0 * 0.005)
    assert (model.supports[-1].node_set, model.supports[-1].dofs) == ("cut", ("p",))
    assert model.steps[0].analysis == "transient"
    assert model.contacts == base.contacts  # an elastic one lets nothing through
