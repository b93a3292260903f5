"""A linear toy of realistic shape: 13 force and 11 speed levels, three fitted parameters, twelve candidates.

Signatures are smooth curves of the kind the tissue gives (offsets, toes, scales, curvatures), many of them
alike; one effect outside the library; one grid; one pair that is the same in these data.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from limbcli.diagnosis.explanations.forward_model import (
    Data,
    Direction,
    Explanation,
    Facts,
    Fitted,
    Prior,
    Priors,
    Proposal,
    Scalable,
)
from limbcli.diagnosis.explanations.noise import Noise, common, independent
from limbcli.errors import SolveError

N_FORCE, N_SPEED = 13, 11
X, Z = np.linspace(0, 1, N_FORCE), np.linspace(0, 1, N_SPEED)
TYPICAL, SIZE_SD = 4.0, 6.0  # plausible size of every effect, and the deviation of its prior
TISSUE = np.array([1.0, 0.5, 0.3])


def stack(force, speed) -> np.ndarray:
    return np.concatenate([np.broadcast_to(force, N_FORCE), np.broadcast_to(speed, N_SPEED)]).astype(float)


BASE = np.stack(
    [stack(X**1.3, 0.5), stack(0.0 * X, 0.5) * 0 + stack(X**2 - 0.3 * X, 0.6 * Z**2), stack(X**3, 0.05 * Z)],
    axis=1,
) * 40  # fmt: skip
SIGNATURES: dict[str, tuple[tuple[str, np.ndarray], ...]] = {
    "offset": (("", stack(np.where(X > 0, 1.0, 0.0), 0)),),
    "toe": (("", stack(np.exp(-6 * X), 0.3 * np.exp(-4 * Z))),),
    "twin-of-toe": (("", stack(np.exp(-6 * X), 0.3 * np.exp(-4 * Z)) * 0.8),),
    "bias": (("", stack(0, Z - 0.5)),),
    "late": (("", stack(np.maximum(X - 0.7, 0) * 4, 0)),),
    "guided": (("", stack(0, Z**4)),),
    "step": (("", stack((X > 0.55) * 1.0, 0)),),
    "jump": (("", stack(0, (Z > 0.45) * 1.0)),),
    "place": tuple((f"at {c:g}", stack(np.exp(-(((X - c) / 0.12) ** 2)), 0)) for c in (0.25, 0.5, 0.75)),
    "hump": (("", stack(np.sin(np.pi * X), -0.5 * np.sin(np.pi * Z))),),
    "wave": (("", stack(0, np.sin(2 * np.pi * Z))),),
    "masked": (("", BASE @ np.array([0.02, 0.03, -0.02]) + 0.01 * stack(np.sin(5 * X), 0)),),
}
ONE_SIDED = {"toe", "twin-of-toe", "late", "guided", "place"}
OUTSIDE = stack(1.2 * np.cos(9 * X), 0.9 * np.cos(7 * Z + 1))
_WIDE = Prior.uniform(-1e3, 1e3)  # of the tissue's parameters


def prior_of(name: str) -> Prior:
    return Prior(0.0, SIZE_SD, 0.0 if name in ONE_SIDED else -np.inf)


@dataclass
class Toy:
    """y = 3 curves + effects + noise of deviation 1 (and a common gain on the speeds).

    failing : effect whose fits do not converge; unsimulated : effect whose fits cannot be simulated
    readings : effects that need no simulation
    """

    y: np.ndarray
    source: str = "repeats"
    stated: float = 1.0
    failing: str = ""
    unsimulated: str = ""
    readings: frozenset[str] = frozenset()
    scalable: Sequence[Scalable] = ()

    @property
    def data(self) -> Data:
        n = N_FORCE + N_SPEED
        noise = Noise(
            (
                independent("measurement", np.full(n, self.stated), source=self.source),
                common("gain", 0.5 * stack(0, 1), source="spec"),
            ),
            self.source,
        )
        order = np.concatenate([np.arange(N_FORCE), np.arange(N_SPEED)]).astype(float)
        force = np.arange(n) < N_FORCE
        groups = {"force": force, "speed": ~force, "early force": force & (order < 4),
                  "late force": force & (order >= 9), "late speed": ~force & (order > 7)}  # fmt: skip
        blocks = {f"every third {k}": order % 3 == k for k in range(3)}
        channel = tuple("force" if each else "speed" for each in force)
        return Data(self.y, channel, order, noise, groups, blocks)

    @property
    def candidates(self) -> Sequence[Facts]:
        return [
            Facts(name, f"{name} is there", "tissue", {name: TYPICAL}, simulated=name not in self.readings)
            for name in SIGNATURES
        ]

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """The largest posterior within the sizes' limits, at the best point of the effects' grids."""
        if self.failing and self.failing in explanation:
            raise SolveError("the toy does not converge", where="toy", fix="none")
        root = np.linalg.inv(np.linalg.cholesky(self.data.noise.covariance))
        priors = (*[_WIDE] * BASE.shape[1], *(prior_of(name) for name in explanation))
        rows = np.eye(len(priors))[BASE.shape[1] :] / SIZE_SD
        fits = []
        for points in itertools.product(*(SIGNATURES[name] for name in explanation)):
            J = np.column_stack([BASE, *(column for _, column in points)])
            A, b = np.vstack([root @ J, rows]), np.concatenate([root @ self.y, np.zeros(len(rows))])
            bounds = ([each.low for each in priors], [each.high for each in priors])
            theta = lsq_linear(A, b, bounds, method="bvls").x if ONE_SIDED & set(explanation) else None
            theta = np.linalg.lstsq(A, b, rcond=None)[0] if theta is None else theta
            fits.append((float(np.sum((A @ theta - b) ** 2)), J, theta, points))
        cost, J, theta, points = min(fits, key=lambda each: each[0])
        names = ("stiffness", "bend", "toe-in")
        return Fitted(
            explanation, J @ theta, J, names, dict(zip([*names, *explanation], theta.tolist(), strict=True)),
            explanation, point=", ".join(point for point, _ in points if point),
            priors=Priors.about(theta, priors),
            ln_points=float(np.log(np.mean([np.exp(-0.5 * (each[0] - cost)) for each in fits]))),
        )  # fmt: skip

    def verified(self, fitted: Fitted) -> Fitted:
        if self.unsimulated and self.unsimulated in fitted.explanation:
            raise SolveError("the toy cannot be simulated", where="toy", fix="none")
        return fitted

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        return [
            Direction(column[:, None], {name: prior_of(name)}, point) for point, column in SIGNATURES[name]
        ]

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        """A thermometer that sees `toe` alone, and one that sees nothing."""
        toe, none = {}, {}
        for fit in fits:
            slope = np.tile([float(n == "toe") for n in (*fit.base_names, *fit.effect_names)], (3, 1))
            toe[fit.explanation] = np.full(3, fit.values.get("toe", 0.0)), slope
            none[fit.explanation] = np.zeros(3), 0.0 * slope
        return [
            Proposal("look at the toe", "sees toe", toe, np.eye(3)),
            Proposal("look away", "sees nothing", none, np.eye(3)),
        ]


def make(rng: np.random.Generator, effects: Mapping[str, float] | None = None, *, outside: float = 0.0,
         sd: float = 1.0, **more) -> Toy:  # fmt: skip
    """Data with these effects, one with a grid in its middle."""
    y = BASE @ TISSUE + sd * rng.standard_normal(N_FORCE + N_SPEED)
    y += 0.5 * rng.standard_normal() * stack(0, 1) + outside * OUTSIDE
    for name, size in (effects or {}).items():
        y = y + size * SIGNATURES[name][len(SIGNATURES[name]) // 2][1]
    return Toy(y, **more)


def drawn(rng: np.random.Generator, explanation: Explanation) -> tuple[Toy, dict[str, float]]:
    """Data with these effects, at sizes and points of their grids drawn from their priors; and the sizes."""
    y, sizes = make(rng).y, {}
    for name in explanation:
        size = SIZE_SD * rng.standard_normal()
        sizes[name] = abs(size) if name in ONE_SIDED else size
        points = SIGNATURES[name]
        y = y + sizes[name] * points[rng.integers(len(points))][1]
    return Toy(y), sizes
