"""The verdict of a fit (`inference.agreement`) as the page shows it: a colour, a word and a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

from limbcli.reporting.numbers import number
from limbcli.reporting.reportlet import Mood

State = Literal["good", "doubtful", "bad", "untested"]  # as a fit writes it

_MOODS: Mapping[State, Mood] = {"good": "fine", "doubtful": "warning", "bad": "failed", "untested": "warning"}
_SILENT = (
    "not tested: this result does not say whether the model agrees with the data; run `limbcli fit` again"
)


@dataclass(frozen=True)
class AgreementView:
    """State ("good", "doubtful", "bad", "untested") and the sentence with the numbers that decided it.

    rms : root mean square of the differences under load, in the unit of the quantity
    too_close : whether the differences are smaller than the counted noise allows
    """

    state: State
    words: str
    rms: float | None = None
    too_close: bool = False

    @property
    def mood(self) -> Mood:
        return _MOODS[self.state]

    @property
    def sentence(self) -> str:
        """
        >>> AgreementView("bad", "off by 2 N").sentence
        'Bad: off by 2 N.'
        """
        words = self.words.rstrip(".")
        return sentence_of(words if self.state == "untested" else f"{self.state}: {words}")


def sentence_of(words: str) -> str:
    """
    >>> sentence_of("geometry assumed, not imaged: a limb")
    'Geometry assumed, not imaged: a limb.'
    """
    return f"{words[0].upper()}{words[1:]}." if words else ""


UNTESTED = AgreementView("untested", _SILENT)


def agreement_view(data: Mapping[str, Any], part: str = "") -> AgreementView:
    """Agreement of one part of a fit's result ("force", "speeds"), or of the whole if `part` is "".

    The whole has the words of its worst part.

    >>> told = {"agreement": {"state": "bad", "force": {"state": "good", "words": "a"},
    ...     "speeds": {"state": "bad", "words": "b"}}}
    >>> agreement_view(told).words, agreement_view(told, "force").state, agreement_view({}).state
    ('b', 'good', 'untested')
    """
    whole = data.get("agreement") or {}
    parts = [each for each in map(whole.get, ("tissue", "force", "speeds")) if each]
    found = (whole.get(part) or {}) if part else whole
    if found.get("state") not in _MOODS:
        return UNTESTED
    state = cast(State, found["state"])
    told = found.get("words") or next(
        (each["words"] for each in parts if each.get("state") == state), _SILENT
    )
    return AgreementView(state, str(told), number(found.get("rms")), found.get("too_close") is True)
