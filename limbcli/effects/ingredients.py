"""Effects with sizes that a simulated model contains: what they change, and how they are simulated."""

from __future__ import annotations

from limbcli.effects.effect import Effect, Theta
from limbcli.effects.stiffness_places import Stiffness
from limbcli.model import LimbModel

Ingredients = tuple[tuple[Effect, Theta], ...]
_SET_UP = ("mesh", "domains", "bodies", "supports", "drives", "springs", "contacts", "curves")


def names_of(ingredients: Ingredients) -> tuple[str, ...]:
    return tuple(effect.name for effect, _ in ingredients)


def is_numerical(ingredients: Ingredients) -> bool:
    """Whether there are effects and all of them are numerical (mesh, cut, contact)."""
    return bool(ingredients) and all(effect.kind == "numerical" for effect, _ in ingredients)


def has_fitted_size(ingredients: Ingredients) -> bool:
    """Whether a parameter is neither at its null value nor at the start value used for sensitivities."""
    return any(
        theta.get(p.name, p.null) not in (p.null, p.start)
        for effect, theta in ingredients
        for p in effect.parameters
    )


def laws(ingredients: Ingredients) -> Ingredients:
    """The effects that change more than a factor on all stiffnesses."""
    return tuple(each for each in ingredients if each[0].stiffness is None)


def stiffness_fields(ingredients: Ingredients, *, waves: bool = False) -> tuple[Stiffness, ...]:
    """Stiffness fields of the effects that are a factor on all stiffnesses; `waves`: for the wave speeds,
    without effects that have a separate law there."""
    return tuple(
        effect.factor(theta) for effect, theta in ingredients
        if effect.stiffness is not None and not (waves and effect.waves is not None)
    )  # fmt: skip


def is_of_law_alone(model: LimbModel, changed: LimbModel) -> bool:
    """Whether the models differ only in their materials, so that they can share a solver session: mesh,
    contact, supports and bodies are fixed when it is set up."""
    return all(getattr(model, name) == getattr(changed, name) for name in _SET_UP)


def touches_loads(effect: Effect, model: LimbModel) -> bool:
    """Whether the effect changes more of a model than its materials."""
    return effect.stiffness is None and not is_of_law_alone(model, effect.apply(model, effect.start))
