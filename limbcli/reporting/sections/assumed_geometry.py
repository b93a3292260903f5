"""For a limb that was not imaged: how much its assumed geometry contributes to the intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from limbcli.reporting.numbers import DASH, number, significant
from limbcli.reporting.reportlet import Cell, PageTable, head
from limbcli.significant_digits import short

_NAMES = {"f_kappa": "f_κ", "m": "m"}


def geometry_tables(site: str, data: Mapping[str, Any]) -> tuple[PageTable, ...]:
    """Both contributions to the 95 % intervals, and all variations; empty if the geometry was imaged.

    data : content of fit.json
    """
    uncertainty = data.get("geometry_uncertainty")
    if not isinstance(uncertainty, Mapping):
        return ()
    return _parts(site, uncertainty), _variations(site, uncertainty)


def _parts(site: str, uncertainty: Mapping[str, Any]) -> PageTable:
    rows = []
    for name, symbol in _NAMES.items():
        cells = [
            Cell(_interval((uncertainty.get(key) or {}).get(name)))
            for key in ("interval_95_noise", "interval_95")
        ]
        alone = number((uncertainty.get("standard_error_fraction") or {}).get(name))
        share = DASH if alone is None else f"{short(100 * alone, 2)} %"
        rows.append((Cell(symbol, lead=True), *cells, Cell(share)))
    names = head(
        "parameter", "95 %: noise and mesh only", "95 %: with the geometry", "geometry only, one deviation"
    )
    return PageTable(
        f"Site {site}: uncertainty from the assumed geometry ({uncertainty.get('words')})",
        (names,),
        tuple(rows),
    )


def _variations(site: str, uncertainty: Mapping[str, Any]) -> PageTable:
    rows = []
    for each in uncertainty.get("variations") or ():
        changes = [known for value in each["force_change_fraction"] if (known := number(value)) is not None]
        shifts = [number(each["log_shift"].get(name)) for name in _NAMES]
        reach = f"{_signed(min(changes))} to {_signed(max(changes))} %" if changes else DASH
        reported = [Cell(DASH if known is None else f"{_signed(known)} %") for known in shifts]
        rows.append((Cell(str(each["words"]), lead=True), Cell(reach), *reported))
    names = head("varied", "force, over the levels", "f_κ (ln)", "m (ln)")
    caption = f"Site {site}: alternative geometries, and how far each would shift the parameters"
    return PageTable(caption, (names,), tuple(rows))


def _signed(share: float) -> str:
    """Percentage with its sign, unless it rounds to zero.

    >>> _signed(0.0123), _signed(-0.0002), _signed(-1.5)
    ('+1.2', '0.0', '-150.0')
    """
    return f"{100 * share:+.1f}" if abs(100 * share) >= 0.05 else "0.0"


def _interval(found: Sequence[float | None] | None) -> str:
    """
    >>> _interval([3.5, None]), _interval(None)
    ('above 3.50', '–')
    """
    low, high = (number(each) for each in found) if found else (None, None)
    if low is None and high is None:
        return "open" if found else DASH
    if low is None or high is None:
        return f"above {significant(low)}" if low is not None else f"below {significant(high or 0.0)}"
    return f"{significant(low)} to {significant(high)}"
