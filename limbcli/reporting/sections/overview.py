"""Overview: findings at each site, progress of each stage, and warnings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from limbcli.numbers.interval_limits import Flag
from limbcli.reporting.agreement_view import AgreementView, sentence_of
from limbcli.reporting.figures.limb_views import limb_place_figure
from limbcli.reporting.fit_view import EstimateView, FitView, StepView, read_fit_view
from limbcli.reporting.numbers import interval, quantity
from limbcli.reporting.outcome import Outcome
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import MOOD_WORDS, Mood, Picture, worst_mood
from limbcli.reporting.sections.diagnosis import in_short
from limbcli.reporting.sections.next_steps import (
    SourcedWarning,
    WarningGroup,
    WarningKind,
    changes_of,
    next_steps,
    warning_groups,
)
from limbcli.reporting.sections.parameters import parameter_warnings


@dataclass(frozen=True)
class Fact:
    """One key figure of a card: name, value with unit, and a remark on its certainty."""

    name: str
    value: str
    remark: str
    mood: Mood = "fine"


@dataclass(frozen=True)
class StageBadge:
    """One stage's state."""

    stage: str
    mood: Mood
    words: str


@dataclass(frozen=True, kw_only=True)
class SiteGlance:
    """The card of a site.

    fit : whether the model agrees with the data; None without a fit
    weak : names of the parameters that the data do not determine
    """

    name: str
    place: str
    mood: Mood
    sentence: str
    pills: tuple[StageBadge, ...]
    facts: tuple[Fact, ...] = ()
    command: str = ""
    fit: AgreementView | None = None
    weak: tuple[str, ...] = ()
    next_steps: tuple[str, ...] = ()
    diagnosis: str = ""
    picture: Picture | None = None

    @property
    def word(self) -> str:
        """The state in words."""
        return "failed" if self.mood == "failed" and not self.facts else MOOD_WORDS[self.mood]


@dataclass(frozen=True, kw_only=True)
class Overview:
    mood: Mood
    sentence: str
    sites: tuple[SiteGlance, ...]
    failures: tuple[Outcome, ...]
    warnings: tuple[SourcedWarning, ...]
    warning_groups: tuple[WarningGroup, ...] = ()


_PILL_WORDS: dict[str, tuple[Mood, str]] = {
    "done": ("fine", "done"),
    "failed": ("failed", "failed"),
    "missing": ("missing", "not run"),
}


def overview(page: ReportData) -> Overview:
    """Cards, stage badges and warnings for the top of the page."""
    sites = tuple(_on_limb(_site(page, site), site) for site in page.sites)
    every = [SourcedWarning("report", text, WarningKind.PAGE) for text in page.notices]
    for site in page.sites:
        every += [SourcedWarning(f"levels {site.name}", text, WarningKind.LEVELS) for text in site.warnings]
    for outcome, text in page.outcomes.warnings():
        every.append(SourcedWarning(outcome.label, text, changes_of(outcome.stage)))
    every += [SourcedWarning("parameters", text, WarningKind.PARAMETERS) for text in parameter_warnings(page)]
    first: dict[str, SourcedWarning] = {}
    for each in every:
        first.setdefault(each.text, each)
    ranked = warning_groups(list(first.values()), page)
    warnings = [each for group in ranked for each in group.warnings]
    failures = page.outcomes.failed
    sentence = _sentence(sites, failures, len(warnings))
    if page.case.imaging.assumed:
        sentence = f"{sentence_of(page.case.imaging.assumed)} {sentence}"
    mood = _overall(sites, bool(failures), bool(warnings))
    return Overview(
        mood=mood, sentence=sentence, sites=sites, failures=failures, warnings=tuple(warnings),
        warning_groups=ranked,
    )  # fmt: skip


def _overall(sites: tuple[SiteGlance, ...], failed: bool, warned: bool) -> Mood:
    moods = {each.mood for each in sites}
    if failed or "failed" in moods:
        return "failed"
    if "missing" in moods:
        return "missing"
    return "warning" if warned or "warning" in moods else "fine"


def _sentence(sites: tuple[SiteGlance, ...], failures: tuple[Outcome, ...], n_warnings: int) -> str:
    fitted = [each for each in sites if each.facts]
    weak = [f"{', '.join(each.weak)} at {each.name}" for each in fitted if each.weak]
    judged = [(each.name, each.fit) for each in fitted if each.fit is not None]
    text = ""
    for state, words in (("bad", "Poor"), ("doubtful", "Doubtful")):
        text += "".join(f"{words} fit at {name}: {fit.words}. " for name, fit in judged if fit.state == state)
    among = f"{len(fitted)} of {len(sites)} {'site' if len(sites) == 1 else 'sites'}"
    text += f"The tissue was fitted at {among}." if sites else "No tissue was fitted: the case has no site."
    if fitted and not weak and not any(fit.state == "bad" for _, fit in judged):
        text += " All fitted parameters are identified."
    if weak:
        text += f" Not reliable as tissue properties: {'; '.join(weak)}."
    if failures:
        text += f" Failed: {', '.join(each.label for each in failures)}."
    if n_warnings:
        words = "1 warning: read it" if n_warnings == 1 else f"{n_warnings} warnings: read them"
        text += f" {words} before using a number from this page."
    return text


def _site(page: ReportData, site: SiteMaterial) -> SiteGlance:
    outcome = page.outcomes.of("fit", site.name)
    stages = [page.outcomes.of("segment")]
    stages += [each for each in page.outcomes.all if each.site == site.name]
    pills = tuple(
        StageBadge(each.stage, *(("missing", "held up") if each.held_by else _PILL_WORDS[each.status]))
        for each in stages
    )
    result = outcome.usable
    if result is None:
        stopped = next((each for each in stages if each.status == "failed"), None)
        if stopped is not None and stopped.failure is not None:
            sentence = f"No parameters: {stopped.stage} failed ({stopped.failure.headline})."
            return SiteGlance(name=site.name, place=site.place, mood="failed", sentence=sentence, pills=pills)
        following = next(each for each in stages if each.status != "done")
        sentence = f"No parameters yet: {following.stage} has not been run."
        return SiteGlance(
            name=site.name, place=site.place, mood="missing", sentence=sentence, pills=pills,
            command=following.command,
        )  # fmt: skip
    view = read_fit_view(result)
    facts = _facts(view)
    weak = tuple(each.name for each in view.last.estimates if not each.is_sound) if view.last else ()
    return SiteGlance(
        name=site.name, place=site.place, mood=worst_mood(view.whole.mood, *(each.mood for each in facts)),
        sentence=_site_sentence(view), facts=facts, pills=pills, fit=view.whole, weak=weak,
        next_steps=next_steps(page, site, view), diagnosis=in_short(page, site) or "",
    )  # fmt: skip


def _on_limb(glance: SiteGlance, site: SiteMaterial) -> SiteGlance:
    """With the picture of the limb, and the place in words before its coordinates."""
    limb = site.on_limb
    if limb is None:
        return glance
    alt = f"The limb {limb.view.name}, with the probe's face at site {site.name}: {limb.words}."
    picture = Picture(f"place-{site.name}", alt, limb_place_figure(limb), vector=False)
    return replace(glance, place=f"{limb.words}; {glance.place}", picture=picture)


def _facts(view: FitView) -> tuple[Fact, ...]:
    step = view.last
    if step is None:
        return ()
    facts = [*_at_rest(view, step)]
    facts += [_estimate(each) for each in step.estimates if each.name in ("m", "f_κ") and each.is_sound]
    size = step.rmse_n if view.force.rms is None else view.force.rms
    remark = f"{view.force.state}; R² {quantity(step.r2, '', digits=4)}"
    missed = Fact("force misfit under load (RMS)", quantity(size, "N", digits=2), remark, view.force.mood)
    return (missed, *facts) if view.force.state == "bad" else (*facts, missed)


def _at_rest(view: FitView, step: StepView) -> list[Fact]:
    """µ, E and c at rest, each with its interval: what papers quote."""
    c = step.estimate("c") or EstimateView(name="c", value=step.c_kpa, unit="kPa", flag=Flag.FIXED)
    source = view.c_source or "of unknown origin"
    named = (
        ("µ at rest, shear modulus", 0.5, "c/2"),
        ("E at rest, Young’s modulus", 1.5, "3µ, of nearly incompressible tissue"),
        ("c = 2µ", 1.0, f"{source}; held fixed"),
    )
    facts = []
    for title, factor, remark in named:
        own = c.times(factor, title, "kPa") or c
        known = own.low is not None and own.high is not None
        reach = f"95 %: {interval((own.low, own.high))}; " if known else ""
        facts.append(Fact(title, quantity(own.value, "kPa"), reach + remark, "neutral"))
    return facts


def _left_open(step: StepView) -> str:
    """One sentence on what the data do not determine; "" if all is determined."""
    open_ones = [f"{each.name} {each.headline} ({each.flag})" for each in step.estimates if not each.is_sound]
    return f" Left open by these data: {'; '.join(open_ones)}." if open_ones else ""


_TITLES = {"m": "m, stiffening", "f_κ": "f_κ, resistance to volume change"}


def _estimate(each: EstimateView) -> Fact:
    """
    >>> _estimate(EstimateView(name="m", value=4.1, low=3.6, high=4.7, flag="identified")).remark
    'identified, 95 %: 3.60 to 4.70'
    """
    remark = each.flag
    if each.low is not None and each.high is not None:
        remark += f", 95 %: {interval((each.low, each.high))}"
    return Fact(_TITLES[each.name], each.headline.text, remark, "fine" if each.is_sound else "warning")


def _site_sentence(view: FitView) -> str:
    step = view.last
    told = [each.sentence for each in (view.force, view.speeds) if each is not None]
    return (
        f"{' '.join(told)} {step.label}, {view.element} elements, {view.solver}.{_left_open(step)}"
        if step
        else "The fit produced no parameters."
    )
