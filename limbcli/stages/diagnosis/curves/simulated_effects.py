"""The effects that a model is simulated with: what of them changes mesh, loads, law or stiffness."""

from __future__ import annotations

from functools import partial

from limbcli.effects.base import Effect, Theta
from limbcli.effects.places import Places, Stiffness
from limbcli.model import Array, LimbModel

Ingredients = tuple[tuple[Effect, Theta], ...]
_SET_UP = ("mesh", "domains", "bodies", "supports", "drives", "springs", "contacts", "curves")


def is_numerical(ingredients: Ingredients) -> bool:
    """Whether there is something changed, and nothing but mesh, cut or contact."""
    return bool(ingredients) and all(effect.kind == "numerical" for effect, _ in ingredients)


def fields(ingredients: Ingredients, *, waves: bool = False) -> tuple[Stiffness, ...]:
    """Of effects that are a factor on all stiffnesses; `waves`: as the scanner's window meets them."""
    return tuple(
        partial(_stiffness_of, effect, theta) for effect, theta in ingredients
        if effect.stiffness is not None and not (waves and effect.waves is not None)
    )  # fmt: skip


def _stiffness_of(effect: Effect, theta: Theta, places: Places) -> Array:
    assert effect.stiffness is not None
    return effect.stiffness(places, theta)


def has_fitted_size(ingredients: Ingredients) -> bool:
    """Whether a parameter stands neither at its null value nor where its sensitivity is taken."""
    return any(
        theta.get(p.name, p.null) not in (p.null, p.start)
        for effect, theta in ingredients
        for p in effect.parameters
    )


def is_of_law_alone(model: LimbModel, changed: LimbModel) -> bool:
    """Whether they differ in their materials alone: mesh, contact, supports and bodies are set up with a
    session."""
    return all(getattr(model, name) == getattr(changed, name) for name in _SET_UP)


def touches_loads(effect: Effect, model: LimbModel) -> bool:
    """Whether the effect changes more of a model than its materials."""
    return effect.stiffness is None and not is_of_law_alone(model, effect.apply(model, effect.start))
