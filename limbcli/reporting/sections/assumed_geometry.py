"""For a limb that was not imaged: how much its assumed geometry contributes to the intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.numbers.significant_digits import short
from limbcli.reporting.numbers import DASH, interval, number, range_percent, signed_percent
from limbcli.reporting.reportlet import PageTable, table

SYMBOLS = {"f_kappa": "f_κ", "m": "m"}


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
    for name, symbol in SYMBOLS.items():
        both = ("interval_95_noise", "interval_95")
        cells = [interval((uncertainty.get(key) or {}).get(name)) for key in both]
        alone = number((uncertainty.get("standard_error_fraction") or {}).get(name))
        share = DASH if alone is None else f"{short(100 * alone, 2)} %"
        rows.append((symbol, *cells, share))
    names = (
        "parameter", "95 %: noise and mesh only", "95 %: with geometry and boundaries",
        "geometry only, one deviation",
    )  # fmt: skip
    caption = f"Site {site}: uncertainty from the assumed geometry ({uncertainty.get('words')})"
    return table(caption, names, rows)


def _variations(site: str, uncertainty: Mapping[str, Any]) -> PageTable:
    rows = []
    for each in uncertainty.get("variations") or ():
        shifts = [number(each["log_shift"].get(name)) for name in SYMBOLS]
        reported = [DASH if known is None else f"{signed_percent(known)} %" for known in shifts]
        rows.append((str(each["words"]), range_percent(each["force_change_fraction"]), *reported))
    names = ("varied", "force, over the levels", "f_κ (ln)", "m (ln)")
    caption = f"Site {site}: alternative geometries, and how far each would shift the parameters"
    return table(caption, names, rows)
