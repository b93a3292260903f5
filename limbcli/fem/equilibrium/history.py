"""Viscoelastic history: FEBio's Prony series on the whole second Piola-Kirchhoff stress.

    S = g0 Se + sum g_i H_i,   H_i <- e_i H_i + h_i (Se - Se_before),
    e_i = exp(-dt/t_i),   h_i = (1 - e_i) t_i / dt,

so that within a step S = scale Se + held, with the number scale = g0 + sum g_i h_i and a tensor `held`
per integration point that is constant during the step.

Source: Puso & Weiss 1998, J Biomech Eng 120:62; FEBio Theory Manual 4.0, section 5.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.fem.elements.element_loops import states_at_points
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array

Terms = tuple[float, tuple[tuple[float, float], ...]]


def factors(dt: float, times: Sequence[float]) -> tuple[Array, Array]:
    """e_i and h_i of a step of length dt (s).

    >>> e, h = factors(1e-9, [1.0])
    >>> round(float(e[0]), 6), round(float(h[0]), 6)
    (1.0, 1.0)
    """
    x = dt / np.asarray(times, dtype=float)
    return np.exp(-x), -np.expm1(-x) / x


@dataclass(eq=False)
class Prony:
    """Stress history of one group.

    before (n_cells, n_gauss, 6) : elastic stress Se at the last accepted step
    series (n_terms, n_cells, n_gauss, 6) : H_i
    """

    terms: Terms
    before: Array
    series: Array

    @classmethod
    def at_rest(cls, terms: Terms, shape: tuple[int, int]) -> Prony:
        return cls(terms, np.zeros((*shape, 6)), np.zeros((len(terms[1]), *shape, 6)))

    def step(self, dt: float) -> tuple[float, Array]:
        """(scale, held) for a step of length dt."""
        g0, pairs = self.terms
        held = np.zeros_like(self.before)
        scale = g0
        for (g, _), e, h, H in zip(pairs, *factors(dt, [t for _, t in pairs]), self.series, strict=True):
            scale += g * float(h)
            held += g * (e * H - h * self.before)
        return scale, held

    def accept(self, dt: float, elastic: Array) -> None:
        """Update the history with the converged elastic stress."""
        e, h = factors(dt, [t for _, t in self.terms[1]])
        for k in range(len(self.series)):
            self.series[k] = e[k] * self.series[k] + h[k] * (elastic - self.before)
        self.before = elastic.copy()


class Histories:
    """The histories of all viscoelastic groups of a system.

    system : that of the current step; the systems of all steps have the same groups
    """

    def __init__(self, system: System):
        self.system = system
        self.prony = {
            k: Prony.at_rest(group.material.prony, group.weight.shape)  # type: ignore[arg-type]
            for k, group in enumerate(system.groups)
            if group.material.prony is not None
        }

    def begin(self, dt: float) -> None:
        """Set the system's stress scales and history stresses for a step of length dt."""
        for k, prony in self.prony.items():
            self.system.scales[k], self.system.histories[k] = prony.step(dt)

    def accept(self, dt: float, state: State) -> None:
        """Update the histories after convergence."""
        for k, prony in self.prony.items():
            prony.accept(dt, elastic_stress(self.system, state, k))


def elastic_stress(system: System, state: State, number: int) -> Array:
    """Elastic second Piola-Kirchhoff stress (n_cells, n_gauss, 6) of a group, without the Prony series."""
    o = replace(system.operands[number], scale=1.0, history=np.zeros((0, 1, 6)))
    _, S, _ = states_at_points(system.threads, o, state.u)
    return S
