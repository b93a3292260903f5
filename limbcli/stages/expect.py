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
```
Keys are those of `data` in fit.json, fit-elements.json, fit-states.json and mesh.json (per site),
segment.json and fit-joint.json.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.errors import CaseError, LimbError
from limbcli.problems import suggestion
from limbcli.results import read_result

EXPECTED_FILE = "expected.toml"
_RULES = frozenset({"value", "tolerance", "relative", "min", "max", "is"})


@dataclass(frozen=True)
class Comparison:
    """One expectation and what was found."""

    name: str
    found: object
    expected: str
    holds: bool

    def __str__(self) -> str:
        mark = "ok  " if self.holds else "FAIL"
        found = f"{self.found:.5g}" if isinstance(self.found, float) else str(self.found)
        return f"{mark} {self.name}: {found} (expected {self.expected})"


def compare(folder: Path, out: Path) -> list[Comparison]:
    """Every expectation of a case against the results in `out`.

    Raises
    ------
    CaseError
        If expected.toml is absent or not understood.
    """
    path = folder / EXPECTED_FILE
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        fix = f"write one, e.g.: [site.p1] m = {{ value = 2.0, tolerance = 0.1 }} ({EXPECTED_FILE})"
        raise CaseError(f"the case has no {EXPECTED_FILE}", where=str(folder), fix=fix) from None
    except (ValueError, OSError) as error:
        raise CaseError(f"{EXPECTED_FILE} cannot be read: {error}", where=str(path), fix="mend it") from error
    found: list[Comparison] = []
    for site, rules in content.get("site", {}).items():
        found += _table(f"site.{site}", rules, out, "fit", site, path)
    for site, rules in content.get("elements", {}).items():
        found += _table(f"elements.{site}", rules, out, "fit-elements", site, path)
    for site, rules in content.get("states", {}).items():
        found += _table(f"states.{site}", rules, out, "fit-states", site, path)
    for site, rules in content.get("mesh", {}).items():
        found += _table(f"mesh.{site}", rules, out, "mesh", site, path)
    for stage in ("segment", "fit-joint"):
        if stage in content:
            found += _table(stage, content[stage], out, stage, None, path)
    return found


def _table(
    label: str, rules: Mapping[str, Any], out: Path, stage: str, site: str | None, path: Path
) -> list[Comparison]:
    try:
        data: Mapping[str, Any] = read_result(out, stage, site=site).data
    except LimbError as error:
        return [Comparison(label, f"no result ({error.what})", "a result", False)]
    return [_compare(f"{label}.{key}", _look_up(data, key), rule, path) for key, rule in rules.items()]


def _look_up(data: Mapping[str, Any], key: str) -> object:
    value: Any = data
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _compare(name: str, found: object, rule: object, path: Path) -> Comparison:
    if not isinstance(rule, dict) or not rule or set(rule) - _RULES:
        wrong = next(iter(set(rule) - _RULES), "") if isinstance(rule, dict) else str(rule)
        raise CaseError(
            f"the expectation of {name} is not understood: {rule!r}",
            where=str(path),
            fix=suggestion(str(wrong), _RULES),
        )
    if "is" in rule:
        return Comparison(name, found, repr(rule["is"]), found == rule["is"])
    low, high = _range(rule)
    holds = isinstance(found, int | float) and not isinstance(found, bool) and low <= found <= high
    return Comparison(name, found, f"{low:.5g} to {high:.5g}", holds)


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
