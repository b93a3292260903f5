"""Values of the command line that Python takes in another form, by the argument's name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer


def _seeds(texts: list[str], flag: str) -> list[tuple[str, tuple[float, ...]]]:
    """
    >>> _seeds(["bone=1,-2.5,30"], "--seed")
    [('bone', (1.0, -2.5, 30.0))]
    """
    found: list[tuple[str, tuple[float, ...]]] = []
    for text in texts:
        kind, _, places = text.partition("=")
        try:
            x, y, z = (float(each) for each in places.split(","))
        except ValueError as error:
            raise typer.BadParameter(f"{text!r} is not KIND=X,Y,Z", param_hint=flag) from error
        if kind not in ("bone", "soft"):
            raise typer.BadParameter(f"{kind!r} is neither bone nor soft", param_hint=flag)
        found.append((kind, (x, y, z)))
    return found


def _thickness(text: str, flag: str) -> float | str:
    from limbcli.site_model.site_layers import thickness_of

    return thickness_of(text, flag)


def _laws(texts: list[str], flag: str) -> dict[str, dict[str, Any]]:
    from limbcli.site_model.site_layers import parse_law

    return dict(map(parse_law, texts))


def _stretches(texts: list[str], flag: str) -> dict[str, float]:
    from limbcli.stages.simulated_subjects.known_stretches import parse_stretches

    return parse_stretches(texts, option=flag)


def _numbers(texts: list[str], flag: str) -> dict[str, float]:
    """Numbers by name, such as "tare_n=0.4"."""
    from limbcli.errors import CaseError

    found = {}
    for text in texts:
        key, _, value = text.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            raise CaseError(
                f"{text!r} is not KEY=NUMBER", where=flag, fix=f"for example {flag} tare_n=0.4"
            ) from None
    return found


VALUE_OF: dict[str, Callable[[Any, str], Any]] = {
    "seeds": _seeds, "skin_mm": _thickness, "fat_mm": _thickness, "layers": _laws,
    "stretch_along": _stretches, "stretch_around": _stretches, "measured": _numbers,
}  # fmt: skip
