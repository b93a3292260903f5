"""What a copy without the reference data proves as well: closed forms, and punches of our own.

The forces in tests/data/punch-forces.json are what this solver gave at a residual of 1e-11 for a block of
12 x 10 x 8 mm on a held base, under a plate or a punch 5 mm wide (`python tests/fem/test_own_references.py`
writes them again). They tell a change, not a truth: the truth is in the closed forms here and beside this
file and, with the reference data, in FEBio's results.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from small_models import punch

from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.materials import ogden_type
from limbcli.materials.stress import cauchy_stress
from limbcli.model import Array, Material
from limbcli.stages.machine.self_test import HEIGHT, SIDE, indentation, nominal_stress

DATA = Path(__file__).resolve().parents[1] / "data"
FORCES = DATA / "punch-forces.json"
TIGHT = Settings(tolerance=1e-11, threads=1)
LAWS = {
    "tissue": ogden_type(c=0.005, f_kappa=20.0, m=3.2),
    "stiffening": ogden_type(c=0.005, f_kappa=100.0, m=8.0),
    "Holmes-Mow": Material("holmes_mow", {"mu": 0.0025, "lambda": 0.01, "beta": 0.6}),
    "neo-Hooke": Material("neo_hooke", {"mu": 0.0025, "lambda": 0.1}),
}


SHAPES = {
    "tet10 under a plate": {"kind": "tet10", "n": (4, 3, 3), "depth": 1.0, "width": 16.0},
    "tet4 under a punch": {"kind": "tet4", "n": (6, 5, 4), "depth": 1.5, "width": 5.0},
    "hex8 under a punch": {"kind": "hex8", "n": (4, 4, 3), "depth": 1.5, "width": 5.0},
}


def forces(shape: str, law: str) -> tuple[list[float], list[float]]:
    """Depths (mm) and forces (N) on the probe at every time that is solved for."""
    model = punch(**SHAPES[shape], levels=3, material=LAWS[law])
    snapshots = Analysis(model, TIGHT).run()
    depth = [-float(each.state.bodies[0].shift[2]) for each in snapshots]
    return depth, [abs(float(each.forces.bodies[0, 2])) for each in snapshots]


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_punch_gives_the_forces_that_were_stored(shape: str, law: str) -> None:
    stored = json.loads(FORCES.read_text(encoding="utf-8"))[f"{shape}, {law}"]
    depth, force = forces(shape, law)
    assert depth == pytest.approx(stored["depth_mm"], abs=1e-12)
    assert force[-1] > 0.1
    assert force == pytest.approx(stored["force_n"], rel=1e-8)


def by_hand(c: float, kappa: float, m: float, F: Array) -> Array:
    """Cauchy stress of the tissue law in principal axes: t_i = c/(2 m) (l_i^m - l_i^-m)/J + kappa (J - 1)."""
    values, axes = np.linalg.eigh(F @ np.swapaxes(F, 1, 2))
    J, stretch = np.linalg.det(F), np.sqrt(values)
    t = c / (2 * m) * (stretch**m - stretch**-m) / J[:, None] + kappa * (J - 1)[:, None]
    return np.einsum("nia,na,nja->nij", axes, t, axes)


@pytest.mark.parametrize(("m", "f_kappa"), [(2.0, 100.0), (8.0, 100.0), (1.389, 113.0), (8.0, 1.0)])
def test_cubes_bear_the_stress_of_the_formula(m: float, f_kappa: float, rng: np.random.Generator) -> None:
    """36 deformations: stretched, sheared and turned at random."""
    F = np.eye(3) + rng.uniform(-0.25, 0.25, (36, 3, 3))
    c = 0.005
    expected = by_hand(c, f_kappa * c, m, F)
    found = cauchy_stress(ogden_type(c=c, f_kappa=f_kappa, m=m), F)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * abs(expected).max())


def test_block_under_a_plate_bears_the_force_of_the_formula() -> None:
    model = indentation()
    last = Analysis(model, TIGHT).run()[-1]
    stretch = 1 + last.state.u[model.mesh.node_sets["top"], 2].mean() / HEIGHT
    assert stretch < 0.7
    assert abs(last.forces.bodies[0, 2]) == pytest.approx(-(SIDE**2) * nominal_stress(stretch), rel=1e-8)


if __name__ == "__main__":
    table = {}
    for pair in itertools.product(SHAPES, LAWS):
        depths, measured = forces(*pair)
        table[", ".join(pair)] = {"depth_mm": depths, "force_n": measured}
    FORCES.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
