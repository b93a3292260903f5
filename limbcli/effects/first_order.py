"""Changes of curves by effects to first order: at the deformation solved without them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_force, frozen_speed
from limbcli.effects.ingredients import Ingredients, laws, stiffness_fields
from limbcli.errors import SolveError
from limbcli.model import Array, LimbModel

_MOST_CHANGE = 10.0  # largest factor on the force at fixed deformation: stretched cells, exponential laws


class Models(Protocol):
    def __call__(self, m: float, ingredients: Ingredients, *, waves: bool) -> LimbModel: ...


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """First-order changes of a site's curves.

    models : an exponent m and effects, and whether for wave speeds -> the model
    """

    models: Models
    density_kg_per_m3: float
    # by m: the model without effects, its force (n,) in N and ln speed (n, n_parts) at its own deformation
    _unchanged: dict[float, tuple[LimbModel, Array, Array]] = field(default_factory=dict)

    def shift(self, m: float, ingredients: Ingredients, kinematics: SolvedDeformation) -> tuple[Array, Array]:
        """Change of ln force (n,) and ln speed (n, n_parts) by effects; kinematics : without them.

        The change of force at depth 0 is set to that of the first level.

        Raises
        ------
        SolveError
            If the force at fixed deformation changes by more than `_MOST_CHANGE` times.
        """
        density, of_law = self.density_kg_per_m3, laws(ingredients)
        if m not in self._unchanged:
            model = self.models(m, (), waves=False)
            speed = frozen_speed(model, kinematics, density_kg_per_m3=density)
            self._unchanged[m] = model, frozen_force(model, kinematics), speed
        plain, force, log_speed = self._unchanged[m]
        changed, in_window = (
            self.models(m, of_law, waves=waves) if of_law else plain for waves in (False, True)
        )
        ratio = frozen_force(changed, kinematics, stiffness_fields(ingredients))[1:] / force[1:]
        if not np.all((ratio > 1 / _MOST_CHANGE) & (ratio < _MOST_CHANGE)):
            raise SolveError(
                f"it changes the force more than {_MOST_CHANGE:g} times at fixed deformation",
                where="diagnose", fix="smaller steps",
            )  # fmt: skip
        fields = stiffness_fields(ingredients, waves=True)
        moved = frozen_speed(in_window, kinematics, fields, density_kg_per_m3=density)
        if of_law:
            kinematics.forget(changed, in_window)
        added = np.log(ratio)
        return np.concatenate([added[:1], added]), moved - log_speed
