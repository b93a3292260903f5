"""Several problems at once: the findings of a check, each with its location and fix."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal, TypeVar

from limbcli.errors import LimbError

# Unit suffixes of our names, and as people write them; a suffix contained in another comes later.
_UNITS = {
    "_mpa_per_mm": "MPa/mm", "_kg_per_m3": "kg/m^3", "_m_per_s": "m/s", "_mpa": "MPa", "_kpa": "kPa",
    "_deg": "degrees", "_mm2": "mm^2", "_mm": "mm", "_n": "N", "_s": "s", "_g": "g",
}  # fmt: skip
_OTHER_UNITS = (
    "um", "mm", "cm", "m", "in", "inch", "n", "mn", "cn", "kn", "gf", "g", "kg", "kgf", "lb", "lbf", "pa",
    "hpa", "kpa", "mpa", "ms", "s", "min", "mm_per_s", "cm_per_s", "m_per_s", "km_per_h", "g_per_cm3",
    "cm2", "mm2", "m2", "rad", "deg",
)  # fmt: skip

AnyError = TypeVar("AnyError", bound=LimbError)
Checked = TypeVar("Checked")


@dataclass(frozen=True)
class Problem:
    """One finding. An "error" stops the work; a "warning" is passed on with the result."""

    what: str
    where: str
    fix: str
    severity: Literal["error", "warning"] = "error"
    family: Literal["case", "measurement"] = "case"

    def __str__(self) -> str:
        return f"{self.what}\n  where: {self.where}\n  fix:   {self.fix}"


def errors_of(problems: Iterable[Problem]) -> list[Problem]:
    return [each for each in problems if each.severity == "error"]


def raise_errors(
    problems: Iterable[Problem], family: type[AnyError], *, then: str = "then `limbcli check CASE` to be sure"
) -> None:
    """Raise one error that carries every problem of severity "error", if there is any.

    then : what to do after several problems have been corrected

    >>> raise_errors([Problem("a", "b", "c", severity="warning")], LimbError)
    """
    found = errors_of(problems)
    if not found:
        return
    first, *others = found
    facts = {"problems": [vars(each) for each in found]}
    if not others:
        raise family(first.what, where=first.where, fix=first.fix, **facts)
    listed = "".join(f"\n{k}. {each}" for k, each in enumerate(found, 1))
    raise family(
        f"{len(found)} problems:{listed}", where=first.where, fix=f"correct them all, {then}", **facts
    )


def checked(value: Checked | None, problems: Iterable[Problem], family: type[AnyError]) -> Checked:
    """The value of a check without errors; otherwise raises as `raise_errors` does.

    >>> checked(3, [Problem("a", "b", "c", severity="warning")], LimbError)
    3
    """
    raise_errors(problems, family)
    assert value is not None
    return value


SPEED_FROM_KPA = "sqrt(E/3) of a Young's modulus E in kPa, or the square root of a shear modulus in kPa"


def shortened(names: Sequence[str], *, most: int = 4) -> str:
    """The first of several names, and how many more there are.

    >>> shortened(["a", "b", "c"], most=2)
    'a, b and 1 more'
    """
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def suggestion(name: str, known: Iterable[str], other_words: Mapping[str, str] | None = None) -> str:
    """The most similar known name, as part of a sentence.

    other_words : names that mean a known one, which goes before those that are only similar

    >>> suggestion("lenght_mm", ["length_mm", "width_mm"])
    "did you mean 'length_mm'?"
    >>> suggestion("depth_cm", ["depth_mm", "force_n"])
    "did you mean 'depth_mm'? Then convert the values: that one is in mm"
    >>> suggestion("speed_kpa", ["speed_m_per_s"])[-44:]
    'or the square root of a shear modulus in kPa'
    >>> suggestion("colour", ["length_mm"])
    "known here: 'length_mm'"
    >>> suggestion("side", ["id", "limb"], {"side": "limb"})
    "did you mean 'limb'?"
    """
    known = sorted(known)
    meant = (other_words or {}).get(name.lower())
    if meant in known:
        return f"did you mean {meant!r}?"
    return similar(name, known) or "known here: " + ", ".join(repr(each) for each in known)


def similar(name: str, known: Iterable[str]) -> str:
    """The same, but empty if no known name is similar."""
    near = get_close_matches(name, sorted(known), n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" + _other_unit(name.lower(), near[0]) if near else ""


def _other_unit(name: str, near: str) -> str:
    """Addition to the message if two names mean the same quantity in two units; otherwise empty."""
    for suffix, unit in _UNITS.items():
        stem = near.removesuffix(suffix)
        rest = name.removeprefix(f"{stem}_")
        if stem != near and name != near and rest != name and rest in _OTHER_UNITS:
            told = f" Then convert the values: that one is in {unit}"
            return f"{told}: {SPEED_FROM_KPA}" if unit == "m/s" and rest.endswith("kpa") else told
    return " It holds E = 3 mu, not the shear modulus mu" if near.endswith("_young_kpa") else ""
