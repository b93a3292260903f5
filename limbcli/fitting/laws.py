"""The laws that `fit` can identify. A law's shape is the set of its parameters other than c = 2 mu.

At fixed shape, forces are proportional to c if the whole model follows the law. With layers of fixed
stiffness they are not, and c, as a ratio, becomes one more parameter of the curve (`beside_layers`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from limbcli.errors import CaseError
from limbcli.errors.problems import suggestion
from limbcli.inference.joint_fit import C_SPAN
from limbcli.inference.likelihood import C_STEP_FACTOR
from limbcli.inference.parameter import F_KAPPA_BOUNDS, M_BOUNDS, FitParameter
from limbcli.inference.two_step_fit import M_STEP_FACTOR
from limbcli.materials.ogden import ogden_type
from limbcli.model import Array, Material, Value

_STEP = 1e-6
LOCKING = (  # one sentence for every kind of fit, so that a page tells it once
    "linear tetrahedra lock: f_kappa is a property of this mesh as much as of the tissue, and its interval "
    "is valid for this mesh only; tet10 elements do not lock (fit --compare-element shows both)"
)
# Held fixed: quadratic elements do not determine it (forces change by 1 to 3 % above 50).
FIBRE_F_KAPPA = 100.0


@dataclass(frozen=True)
class FitLaw:
    """A law: its name, description, shape parameters, and function (c, shape) -> Material.

    has_fibres : has fibres, along y unless `along` sets their direction; fixed : parameters held fixed
    has_ratio : the first shape parameter is a factor on c
    """

    name: str
    words: str
    shape: tuple[FitParameter, ...]
    build: Callable[[float, Array], Material]
    has_fibres: bool = False
    fixed: Mapping[str, float] = field(default_factory=dict)
    has_ratio: bool = False

    def along(self, direction: Value) -> FitLaw:
        """The law with its fibres in this direction (one unit vector, or one per cell), if it has fibres."""
        return replace(self, build=partial(_fibres, direction=direction)) if self.has_fibres else self

    def beside_layers(self) -> FitLaw:
        """The law with a factor on c as additional first shape parameter, so that its effect is simulated."""
        return replace(self, shape=(_C_RATIO, *self.shape), has_ratio=True)

    def material(self, c: float, shape: Array | Sequence[float]) -> Material:
        shape = np.asarray(shape, dtype=float)
        return self.build(c * float(shape[0]), shape[1:]) if self.has_ratio else self.build(c, shape)

    def searched(self, c: float, shape: Array) -> dict[str, Array]:
        """Material parameters that depend on the shape, with d parameter / d shape (n_shape,)."""
        base = _numbers(self.material(c, shape))
        slopes = {name: np.zeros(len(shape)) for name in base}
        for k, value in enumerate(shape):
            up, down = np.array(shape, float), np.array(shape, float)
            up[k], down[k] = value * (1 + _STEP), value * (1 - _STEP)
            above, below = _numbers(self.material(c, up)), _numbers(self.material(c, down))
            for name in base:
                slopes[name][k] = (above[name] - below[name]) / (up[k] - down[k])
        return {name: slope for name, slope in slopes.items() if np.any(slope)}


def _numbers(material: Material) -> dict[str, float]:
    """Numeric parameters of a material and its parts in one mapping; parts of our laws share no names."""
    own = {name: float(each) for name, each in material.parameters.items() if isinstance(each, float | int)}
    for part in material.parts:
        own |= _numbers(part)
    return own


def _fibres(c: float, shape: Array, direction: Value = (0.0, 1.0, 0.0)) -> Material:
    """Ogden-type law with fibres: mu along them is (c/2) (1 + fibre_shear). In tension the fibres add
    4 fibre_tension c + 2 fibre_shear c to the stiffness along them."""
    m, shear, tension = (float(each) for each in shape)
    ground = ogden_type(c=c, f_kappa=FIBRE_F_KAPPA, m=m)
    strands: dict[str, Value] = {"ksi": tension * c, "alpha": 0.0, "beta": 2.0, "mu": shear * c, "lam0": 1.0}
    part = Material("fiber_exp_pow", {**strands, "fiber": direction})
    return Material("mixture", {}, (ground, part), ground.density)


def _two_terms(c: float, shape: Array) -> Material:
    f_kappa, share, m = (float(each) for each in shape)
    half = c / 2
    soft, stiff = (1 - share) * half, share * half
    terms = {"c1": soft, "m1": 2.0, "c2": soft, "m2": -2.0, "c3": stiff, "m3": m, "c4": stiff, "m4": -m}
    return Material("ogden", {**terms, "kappa": f_kappa * c})


def _holmes_mow(c: float, shape: Array) -> Material:
    return Material("holmes_mow", {"mu": c / 2, "lambda": float(shape[0]) * c, "beta": float(shape[1])})


_C_RATIO = FitParameter("c_ratio", 1.0, 1.0 / C_SPAN, C_SPAN, "log", step_factor=C_STEP_FACTOR)
_F_KAPPA = FitParameter("f_kappa", 100.0, *F_KAPPA_BOUNDS, "log")
_M = FitParameter("m", 2.0, *M_BOUNDS, "log", step_factor=M_STEP_FACTOR)

LAWS: Mapping[str, FitLaw] = {
    law.name: law
    for law in (
        FitLaw(
            "ogden", "Ogden type: one pair of exponents m, -m", (_F_KAPPA, _M),
            lambda c, s: ogden_type(c=c, f_kappa=float(s[0]), m=float(s[1])),
        ),
        FitLaw(
            "mooney-rivlin", "Mooney-Rivlin type: m = 2", (_F_KAPPA,),
            lambda c, s: ogden_type(c=c, f_kappa=float(s[0]), m=2.0),
        ),
        FitLaw(
            "neo-hooke", "neo-Hookean, lambda = f_kappa c", (_F_KAPPA,),
            lambda c, s: Material("neo_hooke", {"mu": c / 2, "lambda": float(s[0]) * c}),
        ),
        FitLaw(
            "two-term-ogden", "Mooney-Rivlin type and a stiffening pair m, -m with a share of c",
            (
                _F_KAPPA,
                FitParameter("share", 0.3, 0.001, 0.999, "log", step_factor=3.0),
                FitParameter("m", 8.0, 2.5, 60.0, "log", step_factor=M_STEP_FACTOR),
            ),
            _two_terms,
        ),
        FitLaw(
            "holmes-mow", "Holmes-Mow: exponential, lambda = f_kappa c",
            # Its exponent grows with lambda: nearly incompressible, it can only be solved to small depths.
            (
                FitParameter("f_kappa", 2.0, 0.01, 50.0, "log"),
                FitParameter("beta", 0.3, 0.01, 50.0, "log", step_factor=M_STEP_FACTOR),
            ),
            _holmes_mow,
        ),
        FitLaw(
            "fibres", "Ogden type with fibres in tension: mu along = (c / 2) (1 + fibre_shear); f_kappa 100",
            (
                _M,
                FitParameter("fibre_shear", 0.5, 0.01, 10.0, "log", step_factor=3.0),
                FitParameter("fibre_tension", 0.3, 0.01, 10.0, "log", step_factor=3.0),
            ),
            _fibres, has_fibres=True, fixed={"f_kappa": FIBRE_F_KAPPA},
        ),
    )
}  # fmt: skip


def first_shapes(law: FitLaw) -> list[Array]:
    """Initial guesses: the default shape, and shapes with one parameter doubled (f_kappa: a tenth)."""
    base = np.array([each.start for each in law.shape])
    shapes = [base]
    for k, parameter in enumerate(law.shape):
        moved = base.copy()
        moved[k] = base[k] / 10.0 if parameter.name == "f_kappa" else min(base[k] * 2.0, parameter.high)
        shapes.append(moved)
    return shapes


def law_named(name: str) -> FitLaw:
    """The law of this name. Raises CaseError if there is no such law."""
    if name not in LAWS:
        raise CaseError(
            f"there is no law {name!r}",
            where="--law",
            fix=f"{suggestion(name, LAWS)} Laws: {', '.join(LAWS)}",
        )
    return LAWS[name]
