"""True stretches of the tissue in each state of a site, as needed to simulate measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from limbcli.case import Case, Site
from limbcli.case.parts import Stretch, StretchState
from limbcli.errors import CaseError
from limbcli.errors.problems import suggestion
from limbcli.fitting.state_plan import HIGH, LOW
from limbcli.site_model.prestretch import WAYS


@dataclass(frozen=True)
class KnownStretches:
    """unloaded : stretches, on the scale of the case's states, at which the tissue is truly unloaded
    states : by the state's name, true stretches relative to the unloaded tissue, if the case gives none
    """

    unloaded: Stretch = field(default_factory=Stretch)
    states: Mapping[str, Stretch] = field(default_factory=dict)

    @property
    def given(self) -> bool:
        return self.unloaded != Stretch() or bool(self.states)


@dataclass(frozen=True)
class TrueState:
    """A state and the elastic stretches of its tissue (1), relative to the unloaded tissue."""

    name: str
    along: float
    around: float


def parse_stretches(texts: list[str], *, option: str) -> dict[str, float]:
    """Stretches by the state's name, from "STATE=STRETCH" of the command line.

    Raises CaseError if a text is not of this form, its stretch is out of bounds, or a state is named twice.

    >>> parse_stretches(["bent=0.8", "straight=1.15"], option="--stretch-along")
    {'bent': 0.8, 'straight': 1.15}
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, size = text.rpartition("=")
        try:
            value = float(size)
        except ValueError:
            value = float("nan")
        if not name or not LOW < value < HIGH:
            raise CaseError(
                f"{text!r} is not a state's name and its stretch between {LOW:g} and {HIGH:g}",
                where=option, fix=f"for example {option} {name or 'bent'}=0.8",
            )  # fmt: skip
        if name in found:
            raise CaseError(f"{option} gives state {name} twice", where=option, fix="give each state once")
        found[name] = value
    return found


def known_stretches(
    along: Mapping[str, float], around: Mapping[str, float], unloaded: Stretch = Stretch()
) -> KnownStretches:
    """Known stretches from those along and around the limb, each by the state's name."""
    names = dict.fromkeys([*along, *around])
    return KnownStretches(unloaded, {name: Stretch(along.get(name), around.get(name)) for name in names})


def check_stretches(case: Case, sites: tuple[Site, ...], known: KnownStretches) -> None:
    """Check that the true stretches match the sites' states.

    Raises CaseError if stretches are given for states that no site has, or a state's true stretch is unknown
    or invalid.
    """
    names = {each.name for site in sites for each in site.states}
    if known.given and not names:
        raise CaseError(
            "true stretches are given, but no simulated site has states",
            where=str(case.file),
            fix="add [[site.state]] tables to the site, or omit --stretch-... and --unloaded-...",
        )
    for name in known.states:
        if name not in names:
            raise CaseError(
                f"no simulated site has a state {name!r}",
                where="--stretch-along, --stretch-around",
                fix=suggestion(name, sorted(names)),
            )
    for site in sites:
        true_states(site, known)


def true_states(site: Site, known: KnownStretches) -> list[TrueState]:
    """Every state of a site with its true stretches; empty if the site has no states.

    A stretch given by the case is relative to a length of the user's choice. It is divided by the stretch at
    which the tissue is unloaded, from the case or `known`; if all states give the same stretch, by that one.

    Raises CaseError if a stretch is unknown, is given twice, or is outside the range that a fit of states
    searches.
    """
    ways = [[_elastic(site, each, way, known) for each in site.states] for way in WAYS]
    states = [TrueState(each.name, *pair) for each, *pair in zip(site.states, *ways, strict=True)]
    for state in states:
        for way in WAYS:
            value = getattr(state, way)
            if not LOW < value < HIGH:
                raise CaseError(
                    f"state {state.name} would stretch the tissue {way} the limb to {value:.3g} of its "
                    f"unloaded length; possible values are {LOW:g} to {HIGH:g}",
                    where=f"site {site.name}",
                    fix=f"correct stretch_{way} of the state, or --unloaded-stretch-{way}",
                )
    return states


def _elastic(site: Site, state: StretchState, way: str, known: KnownStretches) -> float:
    given, true = getattr(state.stretch, way), getattr(known.states.get(state.name, Stretch()), way)
    where = f"site {site.name}, state {state.name}"
    if given is None:
        if true is None:
            raise CaseError(
                f"the case does not give the state's stretch {way} the limb, so its true value must be given",
                where=where,
                fix=f"add --stretch-{way} {state.name}=1.0 (over the unloaded tissue)",
            )
        return float(true)
    if true is not None:
        raise CaseError(
            f"the case gives stretch_{way} = {given:g} for the state, and --stretch-{way} gives it again",
            where=where,
            fix=f'omit --stretch-{way} {state.name}=..., or set stretch_{way} = "unknown" in the case',
        )
    return float(given) / _unloaded(site, way, known)


def _unloaded(site: Site, way: str, known: KnownStretches) -> float:
    """The stretch, on the case's scale, at which the tissue is unloaded."""
    of_case, true = getattr(site.unloaded, way), getattr(known.unloaded, way)
    if of_case is not None and true is not None and of_case != true:
        raise CaseError(
            f"the case states that its tissue is unloaded at a stretch of {of_case:g} {way} "
            f"the limb, but --unloaded-stretch-{way} is {true:g}",
            where=f"site {site.name}",
            fix=f"remove one of them: unloaded_stretch_{way} in case.toml, or the option",
        )
    if of_case is not None or true is not None:
        return float(of_case if true is None else true)
    given = {getattr(each.stretch, way) for each in site.states} - {None}
    if len(given) == 1:
        return float(given.pop())
    raise CaseError(
        f"the stretch {way} the limb at which the tissue is unloaded must be given, on the scale of the "
        f"given stretches",
        where=f"site {site.name}",
        fix=f"add --unloaded-stretch-{way} 1.0, or unloaded_stretch_{way} to the site where it is known",
    )
