"""A linear toy of realistic shape: 13 force and 11 speed levels, three fitted parameters, twelve candidates.

Signatures are smooth curves of the kind the tissue gives (offsets, toes, scales,
curvatures), many of them alike; one effect outside the library; one grid; one pair
that is the same in these data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Data, Direction, Explanation, Facts, Fitted, Proposal
from limbcli.diagnostics.model.noise import Noise, common, independent
from limbcli.errors import SolveError

N_FORCE, N_SPEED = 13, 11
X, Z = np.linspace(0, 1, N_FORCE), np.linspace(0, 1, N_SPEED)


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


@dataclass
class Toy:
    """y = 3 curves + effects + noise of deviation 1 (and a common gain on the speeds)."""

    y: np.ndarray
    source: str = "repeats"
    stated: float = 1.0
    failing: str = ""
    roomy: float | None = None  # deviation of a prior that keeps every effect's size near 0
    readings: frozenset[str] = frozenset()  # effects that need no simulation
    interval_widening: float = 1.0

    @property
    def data(self) -> Data:
        n = N_FORCE + N_SPEED
        speeds = stack(0, 1)
        noise = Noise(
            (
                independent("measurement", np.full(n, self.stated), source=self.source),
                common("gain", 0.5 * speeds, source="spec"),
            )
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
            Facts(name, f"{name} is there", "tissue", {name: 4.0}, simulated=name not in self.readings)
            for name in SIGNATURES
        ]

    def _columns(self, name: str, point: str) -> np.ndarray:
        return dict(SIGNATURES[name])[point][:, None]

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        if self.failing and self.failing in explanation:
            raise SolveError("the toy does not converge", where="toy", fix="none")
        inverse = np.linalg.inv(self.data.noise.covariance)
        best = None
        grids = [SIGNATURES[name] for name in explanation]
        for k in range(max((len(g) for g in grids), default=1)):
            points = [g[min(k, len(g) - 1)][0] for g in grids]
            J = np.hstack([BASE, *(self._columns(n, p) for n, p in zip(explanation, points, strict=True))])
            held = np.zeros(J.shape[1])
            held[BASE.shape[1] :] = 0.0 if self.roomy is None else self.roomy**-2
            theta = np.linalg.solve(J.T @ inverse @ J + np.diag(held), J.T @ inverse @ self.y)
            left = self.y - J @ theta
            cost = left @ inverse @ left + theta**2 @ held
            if best is None or cost < best[0]:
                best = (cost, J, theta, points)
        _, J, theta, points = best
        names = ("c", "m", "k")
        values = dict(zip([*names, *explanation], theta.tolist(), strict=True))
        bound = tuple(f"{n} on its bound" for n in explanation if n in ONE_SIDED and values[n] <= 0)
        without = BASE @ theta[:3] if explanation else None
        return Fitted(explanation, J @ theta, J, names, values, explanation, bound, without=without)

    def verified(self, fitted: Fitted) -> Fitted:
        return fitted

    def reported(self, fitted: Fitted, *, scale: float = 1.0, besides=None) -> Reported:
        return Reported(fitted.values, fitted.values)

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        sign = (1,) if name in ONE_SIDED else (0,)
        return [Direction(column[:, None], sign, point, (name,)) for point, column in SIGNATURES[name]]

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        """A thermometer that sees `toe` alone, and one that sees nothing."""
        seen, none, jacobians = {}, {}, {}
        for fit in fits:
            seen[fit.explanation] = np.full(3, fit.values.get("toe", 0.0))
            none[fit.explanation] = np.zeros(3)
            jacobians[fit.explanation] = np.tile(
                [float(n == "toe") for n in (*fit.base_names, *fit.effect_names)], (3, 1)
            )
        return [
            Proposal("look at the toe", "sees toe", seen, jacobians, np.eye(3)),
            Proposal("look away", "sees nothing", none, {k: 0 * v for k, v in jacobians.items()}, np.eye(3)),
        ]


def make(rng: np.random.Generator, effects: Mapping[str, float] | None = None, *, outside: float = 0.0,
         sd: float = 1.0, **more) -> Toy:  # fmt: skip
    y = BASE @ np.array([1.0, 0.5, 0.3]) + sd * rng.standard_normal(N_FORCE + N_SPEED)
    y += 0.5 * rng.standard_normal() * stack(0, 1) + outside * OUTSIDE
    for name, size in (effects or {}).items():
        _, column = SIGNATURES[name][min(1, len(SIGNATURES[name]) - 1)]
        y = y + size * column
    return Toy(y, **more)
