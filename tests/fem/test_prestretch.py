"""Tissue that is stretched before it is loaded: closed forms, balance, and derivatives by its stretches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve
from small_models import block

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.record_fields import cell_fields
from limbcli.materials import ogden_type
from limbcli.model import LimbModel, Material, NodeMap, Support
from limbcli.solvers.session_parameters import law_parameter, parameter_values

C, KAPPA_FACTOR, M = 0.006, 20.0, 5.0
KSI, MU = 0.004, 0.003
TIGHT = Settings(tolerance=1e-11, threads=1)
STRESSES = ("sx", "sy", "sz", "sxy", "syz", "sxz")


def law(F0: np.ndarray, *, m: float = M, fibre: tuple[float, float, float] | None = None) -> Material:
    inner = ogden_type(c=C, f_kappa=KAPPA_FACTOR, m=m)
    if fibre is not None:
        strands = {"ksi": KSI, "alpha": 0.0, "beta": 2.0, "mu": MU, "lam0": 1.0, "fiber": fibre}
        inner = Material("mixture", {}, (inner, Material("fiber_exp_pow", strands)))
    return Material("prestrain", {"F0": tuple(F0.ravel().tolist()), "ramp": 1.0}, (inner,))


def solved(model: LimbModel) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (n, 3), and the mean stresses (6,)."""
    analysis = Analysis(model, TIGHT)
    try:
        last = analysis.run()[-1]
        found = cell_fields(analysis.system, last.state, 0, STRESSES)
        np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), atol=1e-10)
        return last.state.u, found[0]
    finally:
        analysis.close()


def principal_stresses(stretches: np.ndarray, *, fibre_along_x: bool) -> np.ndarray:
    """Cauchy stresses of the law along the axes, written out: (c / 2m) (l^m - l^-m) / J + kappa (J - 1)."""
    J = float(np.prod(stretches))
    stress = C / (2 * M) * (stretches**M - stretches**-M) / J + KAPPA_FACTOR * C * (J - 1)
    square = float(stretches[0]) ** 2
    if fibre_along_x and square > 1:
        stress = stress + np.array([(2 * KSI + MU) * (square - 1) * square / J, 0.0, 0.0])
    return stress


@pytest.mark.parametrize("fibres", [False, True])
@pytest.mark.parametrize("pull", [-0.2, 0.15])
def test_uniaxial_is_the_closed_form(fibres: bool, pull: float) -> None:
    """Pulled along z with free sides: these move until the prestretched law has no stress across them."""
    before = np.array([1.15, 0.95, 1 / (1.15 * 0.95)])
    model = block("tet4", material=law(np.diag(before), fibre=(1.0, 0.0, 0.0) if fibres else None))
    supports = (
        Support("x0", ("x",)), Support("y0", ("y",)), Support("z0", ("z",)),
        Support("z1", ("z",), pull, "ramp"),
    )  # fmt: skip
    u, stress = solved(replace(model, supports=supports))

    def across(sides: np.ndarray) -> np.ndarray:
        after = np.r_[sides, 1 + pull]
        return principal_stresses(after * before, fibre_along_x=fibres)[:2]

    sides = fsolve(across, [0.9, 1.0], xtol=1e-13)
    corner = np.flatnonzero(np.all(np.isclose(model.mesh.points, [1.0, 1.0, 0.0]), axis=1))[0]
    np.testing.assert_allclose(u[corner], [*(sides - 1), pull], atol=1e-8)
    wanted = principal_stresses(np.r_[sides, 1 + pull] * before, fibre_along_x=fibres)
    np.testing.assert_allclose(stress[:3], wanted, atol=1e-10)
    np.testing.assert_allclose(stress[3:], 0.0, atol=1e-10)


def sheared(material: Material, gamma: float) -> LimbModel:
    """All outer nodes moved by gamma z along x."""
    model = block("tet4", (3, 3, 3), material=material, twist=0.05)
    outer = model.mesh.node_sets["outer"]
    field = np.zeros((len(outer), 3))
    field[:, 0] = gamma * model.mesh.points[outer, 2]
    supports = tuple(
        Support("outer", (axis,), NodeMap(f"u{axis}", "outer", field[:, k]), "ramp")
        for k, axis in enumerate("xyz")
    )
    return replace(model, supports=supports)


@pytest.mark.parametrize("stretch", [0.85, 1.2])
def test_simple_shear_is_the_closed_form(stretch: float) -> None:
    """m = 2 and no change of volume: sigma = (c / 4) (b - b^-1), so sigma_xz = c gamma / (2 l^2)."""
    gamma = 0.3
    _, stress = solved(sheared(law(np.diag([stretch, 1.0, 1 / stretch]), m=2.0), gamma))
    l2 = stretch**2
    wanted = [
        C / 4 * (l2 + gamma**2 / l2 - 1 / l2), 0.0, C / 4 * (1 / l2 - gamma**2 / l2 - l2),
        0.0, 0.0, C * gamma / (2 * l2),
    ]  # fmt: skip
    np.testing.assert_allclose(stress, wanted, atol=1e-11)


def test_simple_shear_of_fibres_is_the_closed_form() -> None:
    """Fibres along z, which are stretched by 1.25 before the shear turns them by atan gamma."""
    gamma, stretch = 0.3, 0.8
    F0 = np.diag([stretch, 1.0, 1 / stretch])
    _, stress = solved(sheared(law(F0, m=2.0, fibre=(0.0, 0.0, 1.0)), gamma))
    l2 = stretch**2
    fibre = np.array([gamma, 0.0, 1.0]) / stretch  # F F0 a0
    b = np.array([[l2 + gamma**2 / l2, 0, gamma / l2], [0, 1, 0], [gamma / l2, 0, 1 / l2]])
    dyad, square = np.outer(fibre, fibre), (1 + gamma**2) / l2
    both = dyad @ (b - np.eye(3))
    added = 2 * KSI * (square - 1) * dyad + MU * 0.5 * (both + both.T)
    wanted = np.array(
        [C / 4 * (l2 + gamma**2 / l2 - 1 / l2), 0.0, C / 4 * (1 / l2 - gamma**2 / l2 - l2), 0, 0,
         C * gamma / (2 * l2)]
    )  # fmt: skip
    wanted += [added[0, 0], added[1, 1], added[2, 2], added[0, 1], added[1, 2], added[0, 2]]
    np.testing.assert_allclose(stress, wanted, atol=1e-11)


def test_weights_say_how_the_numbers_of_a_prestrain_move() -> None:
    """Two directions of one gradient have names of their own, and values for warm starts."""
    F0 = np.diag([1.1, 1.0, 1 / 1.1])
    model = block("tet4", material=law(F0))
    key, along = ("tissue", "F0.along"), np.diag([1.0, 0.0, -1 / 1.21])
    found = law_parameter(key, along.ravel(), model)
    np.testing.assert_allclose(found.direction, along)  # type: ignore[union-attr, arg-type]
    values = parameter_values(model, [key], {key: along.ravel()})
    assert values[key] == pytest.approx(np.sum(F0 * along) / np.sum(along**2))
    assert values["tissue", "m1"] == M  # the law's own, though it is wrapped
    with pytest.raises(SolveError, match=r"how the nine numbers of F0.along vary is not given"):
        law_parameter(key, None, model)


def test_a_prestretch_that_is_not_symmetric_comes_before_the_deformation() -> None:
    """F_e = F F_pre and no other order: sheared across the shear that the tissue had before."""
    gamma, before = 0.3, 0.2
    F0, F = np.eye(3), np.eye(3)
    F0[2, 0], F[0, 2] = before, gamma
    _, stress = solved(sheared(law(F0, m=2.0), gamma))
    b = (F @ F0) @ (F @ F0).T
    wanted = C / 4 * (b - np.linalg.inv(b))
    np.testing.assert_allclose(stress[[0, 1, 2, 5]], wanted[[0, 1, 2, 0], [0, 1, 2, 2]], atol=1e-11)
