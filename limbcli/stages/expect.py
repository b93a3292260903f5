"""Compare a case's results with its `expected.toml` (regression over `cases/`).

```toml
[site.p1]
element = { is = "tet10" }             # equal
c_kpa   = { value = 6.0, tolerance = 0.2 }
m       = { value = 7.0, relative = 0.05 }
r2      = { min = 0.99 }
[elements.p1]                          # what `fit --compare-element` found
force_ratio_tet4_over_tet10 = { min = 2.0 }
[mesh.p1]
"fibres.out_of_skin_deg" = { value = 12.0, tolerance = 1.0 }
[segment]
"quality.verdict" = { is = "good" }    # dots walk into tables
[states.p1]                            # what `fit` found of several states
"states.bent.stretch_along.value" = { value = 1.1, tolerance = 0.03 }
[fit-joint]
fibre_shear = { value = 1.0, tolerance = 0.2 }
[socket]
"largest.mean_kpa" = { value = 30.0, tolerance = 1.0 }
```
Keys are those of `data` in fit.json, fit-elements.json, fit-states.json and mesh.json (per site),
segment.json, fit-joint.json and socket.json.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.case.toml_file import read_toml
from limbcli.errors import CaseError, LimbError
from limbcli.errors.problems import suggestion
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, read_result

EXPECTED_FILE = "expected.toml"
_BY_SITE = {"site": "fit", "elements": "fit-elements", "states": "fit-states", "mesh": "mesh"}  # their stages
_OF_THE_CASE = ("segment", "fit-joint", "socket")
_NUMBERS = frozenset({"value", "tolerance", "relative", "min", "max"})
_RULES = _NUMBERS | {"is"}
_DIGITS = 10  # significant digits printed, so that a value just outside its range is distinguishable from it


@dataclass(frozen=True)
class Comparison:
    """One expectation and the value found, printed with enough digits to show why it is not met.

    >>> print(Comparison("m", 2.0000004, "2 to 2", False))
    FAIL m: 2.0000004 (expected 2 to 2)
    """

    name: str
    found: object
    expected: str
    holds: bool

    def __str__(self) -> str:
        mark = "ok  " if self.holds else "FAIL"
        digits = 5 if self.holds else _DIGITS
        found = f"{self.found:.{digits}g}" if isinstance(self.found, float) else str(self.found)
        return f"{mark} {self.name}: {found} (expected {self.expected})"


def keep_expected(folder: Path, work: Path) -> None:
    """Copy the expected.toml of a case that is made again into the new folder `work`."""
    if (folder / EXPECTED_FILE).is_file():
        shutil.copyfile(folder / EXPECTED_FILE, work / EXPECTED_FILE)


def compare(folder: Path, out: Path, *, case: Case | None = None) -> list[Comparison]:
    """Compare every expectation of a case with the results in `out`.

    case : if given, a result counts only if its inputs have not changed since

    Raises CaseError if expected.toml is absent or not understood.
    """
    path = folder / EXPECTED_FILE
    try:
        content = read_toml(path)
    except FileNotFoundError:
        fix = f"write one, e.g.: [site.p1] m = {{ value = 2.0, tolerance = 0.1 }} ({EXPECTED_FILE})"
        raise CaseError(f"the case has no {EXPECTED_FILE}", where=str(folder), fix=fix) from None
    except (ValueError, OSError) as error:
        raise CaseError(
            f"{EXPECTED_FILE} cannot be read: {error}", where=str(path), fix="correct it"
        ) from error
    chain = None if case is None else Chain(case, out)
    found: list[Comparison] = []
    for name, table in content.items():
        if name in _OF_THE_CASE:
            found += _table(name, table, out, name, None, path, chain)
        elif name in _BY_SITE:
            for site, rules in _as_table(table, name, path).items():
                found += _table(f"{name}.{site}", rules, out, _BY_SITE[name], site, path, chain)
        else:
            known = {*_BY_SITE, *_OF_THE_CASE}
            raise CaseError(
                f"there are no expectations of {name!r}", where=str(path), fix=suggestion(name, known)
            )
    return found


def _as_table(content: object, name: str, path: Path) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        fix = f"write it as [{name}], with one key per line below it"
        raise CaseError(f"{name} is not a table: {content!r}", where=str(path), fix=fix)
    return content


def _table(
    label: str, content: object, out: Path, stage: str, site: str | None, path: Path, chain: Chain | None
) -> list[Comparison]:
    rules = {
        key: _rule(f"{label}.{key}", each, path) for key, each in _as_table(content, label, path).items()
    }
    try:
        result = read_result(out, stage, site=site)
    except LimbError as error:
        return [Comparison(label, f"no result ({error.what})", "a result", False)]
    if reason := _why_stale(chain, result):
        return [Comparison(label, f"no up-to-date result ({reason})", "a result", False)]
    return [_compare(f"{label}.{key}", *_looked_up(result.data, key), rule) for key, rule in rules.items()]


def _why_stale(chain: Chain | None, result: StageResult) -> str:
    """Why a result is out of date with respect to the case; empty if it is not."""
    if chain is None:
        return ""
    sites = {each.name: each for each in chain.case.sites}
    if result.site is not None and result.site not in sites:
        return f"the case has no site {result.site}"
    if result.stage == "fit-states" and result.site is not None and not sites[result.site].states:
        return f"site {result.site} has no states"
    together = result.data.get("sites", ()) if result.stage == "fit-joint" else ()
    if gone := [each for each in together if each not in sites]:
        return f"the case has no site {gone[0]}"
    broken = chain.broken(result)
    return "" if broken is None else broken.what


def _looked_up(data: Mapping[str, Any], key: str) -> tuple[object, bool]:
    """(value, True), or (message, False) if there is no value of that name.

    >>> _looked_up({"flags": {"m": "weak"}}, "flags.m"), _looked_up({"element": "tet4"}, "elements")
    (('weak', True), ("not there (did you mean 'element'?)", False))
    """
    value: Any = data
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            hint = f" ({suggestion(part, value)})" if isinstance(value, Mapping) else ""
            return f"not there{hint}", False
        value = value[part]
    return value, True


def _rule(name: str, rule: object, path: Path) -> Mapping[str, Any]:
    """Validate a rule and return it unchanged; a rule that cannot fail is rejected."""
    wrong = ""
    if not isinstance(rule, dict) or not rule or set(rule) - _RULES:
        fix = suggestion(str(next(iter(set(rule) - _RULES), "") if isinstance(rule, dict) else rule), _RULES)
        wrong = "is not valid"
    elif "is" in rule:
        wrong = "has `is` together with other keys" if len(rule) > 1 else ""
        fix = "remove the others: `is` means equal"
    elif no_numbers := [key for key, each in rule.items() if not _is_number(each)]:
        wrong, fix = f"has no number as its {no_numbers[0]}", "give a number, or `is` of anything else"
    elif "value" not in rule and {"tolerance", "relative"} & set(rule):
        wrong, fix = "has a tolerance but no value", "add the value, such as value = 2.0"
    elif min(rule.get("tolerance", 0.0), rule.get("relative", 0.0)) < 0.0:
        wrong, fix = "has a tolerance below 0", "give 0 or more"
    if wrong:
        raise CaseError(f"the expectation of {name} {wrong}: {rule!r}", where=str(path), fix=fix)
    assert isinstance(rule, dict)
    return rule


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _compare(name: str, found: object, is_there: bool, rule: Mapping[str, Any]) -> Comparison:
    if "is" in rule:
        same = found == rule["is"] and isinstance(found, bool) == isinstance(rule["is"], bool)
        return Comparison(name, found, repr(rule["is"]), is_there and same)
    low, high = _range(rule)
    holds = _is_number(found) and low <= found <= high  # type: ignore[operator]
    return Comparison(name, found, f"{low:.{_DIGITS}g} to {high:.{_DIGITS}g}", holds)


def _range(rule: Mapping[str, float]) -> tuple[float, float]:
    """
    >>> _range({"value": 2.0, "tolerance": 0.5}), _range({"value": 2.0, "relative": 0.1})
    ((1.5, 2.5), (1.8, 2.2))
    >>> _range({"min": 0.9})
    (0.9, inf)
    """
    low, high = rule.get("min", float("-inf")), rule.get("max", float("inf"))
    if "value" in rule:
        spread = rule.get("tolerance", 0.0) + abs(rule["value"]) * rule.get("relative", 0.0)
        low, high = max(low, rule["value"] - spread), min(high, rule["value"] + spread)
    return low, high
