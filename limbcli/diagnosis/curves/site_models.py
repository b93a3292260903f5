"""Models of one site with any exponent and effects, and the keys of their cached simulations."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.effect import applied
from limbcli.effects.ingredients import Ingredients, stiffness_fields
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import model_hash
from limbcli.results import plain
from limbcli.site_model.indentation_model import with_tissue
from limbcli.site_model.model_simplification import fewer_steps, softer_jumps
from limbcli.version import __version__

_READING = 3  # version of the evaluation of speeds; increment on changes, as cached curves contain speeds
_READING_OF_FIELDS = 2  # the same for curves with an effect that is a factor on stiffnesses


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteModels:
    """A site's model for any exponent m and effects.

    usual : the model without effects; c : MPa, and f_kappa, of its tissue
    fingerprint : hash of what else the curves depend on
    """

    usual: LimbModel
    c: float
    f_kappa: float
    fingerprint: str
    _contents: dict[str, str] = field(default_factory=dict)

    def of(self, m: float, ingredients: Ingredients = (), *, waves: bool = False) -> LimbModel:
        """waves : the model for wave speeds, in which an effect may have a separate law"""
        tissue = with_tissue(self.usual, c=self.c, f_kappa=self.f_kappa, m=m)
        return applied(tissue, ingredients, waves=waves)

    def to_solve(self, m: float, ingredients: Ingredients, times: Sequence[float]) -> LimbModel:
        """The model made easier to solve, for curves at these times (s).

        With friction, a load step for each time: two change what friction does by 2 % of it.
        """
        model = softer_jumps(self.of(m, ingredients))
        model = replace(model, steps=tuple(replace(each, must_points=tuple(times)) for each in model.steps))
        return fewer_steps(model, len(times)) if model.has_friction else model

    def key(self, m: float, ingredients: Ingredients) -> str:
        """Hash of the exponent and of what the effects make of the model, so that a modified implementation
        of an effect is solved again."""
        parts = [
            [effect.name, {k: round(float(v), 9) for k, v in sorted(theta.items())}]
            for effect, theta in ingredients
        ]
        if stiffness_fields(ingredients, waves=True):
            parts.append(["read", {"fields": _READING_OF_FIELDS}])
        text = json.dumps([self.fingerprint, round(m, 9), parts], sort_keys=True)
        if ingredients and text not in self._contents:
            models = (self.of(m, ingredients, waves=waves) for waves in (False, True))
            self._contents[text] = model_hash(*models)
        return hashlib.sha256((text + self._contents.get(text, "")).encode()).hexdigest()[:24]


def fingerprint(
    model: LimbModel, depths: Sequence[float], *, c: float, f_kappa: float, windows: Windows,
    enough_force: float | None, lines: Array | None, density_kg_per_m3: float,
) -> str:  # fmt: skip
    """Hash of a site's simulations without effects.

    It covers mesh, contact, depths, tissue and its density, the window and the version of its evaluation, the
    force at which simulations end, the tracked lines, and the program version.
    """
    digest = hashlib.sha256(np.ascontiguousarray(model.mesh.points).tobytes())
    digest.update(f"limbcli {__version__}, read {_READING}".encode())
    penalties = [each.penalty for each in model.contacts]
    contents = [[round(float(d), 6) for d in depths], c, f_kappa, repr(windows), penalties, enough_force]
    contents += [density_kg_per_m3]
    digest.update(json.dumps(contents if lines is None else [*contents, plain(lines)]).encode())
    return digest.hexdigest()[:16]
