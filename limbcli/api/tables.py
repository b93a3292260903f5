"""Conversion of rows of plain values to a structured array or a pandas table."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from limbcli.errors import ToolError

if TYPE_CHECKING:  # which help and messages do not need
    import numpy as np
    import pandas
    from numpy.typing import NDArray

Row = Mapping[str, Any]
Table: TypeAlias = "NDArray[np.void]"


def structured(rows: Sequence[Row]) -> Table:
    """A structured array (n_rows,): one field per key, numbers as float64 (missing: NaN), texts as str.

    The fields are those of all rows, in the order of their first occurrence.

    >>> table = structured([{"m": 2.0, "low_95": None}, {"m": 6.0, "low_95": 1.5}])
    >>> table["m"], table["low_95"]
    (array([2., 6.]), array([nan, 1.5]))
    >>> structured([]).shape
    (0,)
    """
    import numpy as np

    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    table = np.zeros(len(rows), dtype=[(name, each.dtype) for name, each in columns.items()])
    for name, each in columns.items():
        table[name] = each
    return table


def _column(values: Sequence[Any]) -> NDArray[Any]:
    import numpy as np

    there = [each for each in values if each is not None]
    if any(isinstance(each, str) for each in there):
        return np.array(["" if each is None else str(each) for each in values])
    if there and len(there) == len(values):
        if all(isinstance(each, bool | np.bool_) for each in there):
            return np.array(values, dtype=bool)
        if all(isinstance(each, int | np.integer) for each in there):
            return np.array(values, dtype=np.int64)
    return np.array([np.nan if each is None else float(each) for each in values], dtype=np.float64)


def plain_rows(table: Table) -> list[dict[str, Any]]:
    """The rows of a structured array as plain values.

    >>> plain_rows(structured([{"force_n": 2.0, "phase": "load"}]))
    [{'force_n': 2.0, 'phase': 'load'}]
    """
    names = table.dtype.names or ()
    return [{name: row[name].item() for name in names} for row in table]


def to_frame(table: Table) -> pandas.DataFrame:
    """The same as a pandas table.

    Raises
    ------
    ToolError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise ToolError(
            f"pandas is not installed ({error})",
            where="to_frame()",
            fix="pip install pandas, or use table(), a numpy array with one field per column",
        ) from error
    return pandas.DataFrame({name: table[name] for name in table.dtype.names or ()})


class Tabular:
    """Base class of results, frozen dataclasses, that have rows and can be converted to a table."""

    def __post_init__(self) -> None:
        """Make paths absolute, so that they stay valid if the working folder changes."""
        for each in fields(self):  # type: ignore[arg-type]
            if isinstance(path := getattr(self, each.name), Path):
                object.__setattr__(self, each.name, path.absolute())

    def rows(self) -> list[dict[str, Any]]:
        """The rows of `table()` as plain values."""
        raise NotImplementedError

    def table(self) -> Table:
        """A structured array (n_rows,), one field per column; names include units, and missing numbers are
        NaN."""
        return structured(self.rows())

    def to_frame(self) -> pandas.DataFrame:
        """The same rows as a pandas table.

        Raises
        ------
        ToolError
            If pandas is not installed.
        """
        return to_frame(self.table())

    def _repr_html_(self) -> str:
        """Notebook representation: the findings with their warnings, as `print` shows them."""
        import html

        return f"<pre>{html.escape(str(self))}</pre>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Terminal representation in IPython: the same as `print`."""
        printer.text("..." if cycle else str(self))


def read_columns(path: Path) -> Table:
    """Read a CSV file of numbers with one header row; empty cells become NaN."""
    with path.open(newline="", encoding="utf-8") as stream:
        return structured(
            [{name: _number(text) for name, text in row.items()} for row in csv.DictReader(stream)]
        )


def _number(text: str | None) -> float | str | None:
    if not text:
        return None
    try:
        return float(text)
    except ValueError:
        return text
