"""Exception classes: one root and a few families, each with its own exit code.

A message states what happened, where, and what to do. The numbers behind it are kept in `facts`, so that a
batch can tabulate them.

>>> error = MeshError("no skin under the probe", where="site p1", fix="move position_mm", gap_mm=31.0)
>>> print(error)
no skin under the probe
  where: site p1
  fix:   move position_mm
>>> error.exit_code, error.facts["gap_mm"]
(5, 31.0)
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from typing import Any


class LimbcliError(Exception):
    """Any failure that limbcli can foresee.

    Parameters
    ----------
    what : one sentence, including the numbers
    where : file, stage, level, node: as precise as known
    fix : what the user should do next
    facts : the numbers, machine-readable; with the site, once `errors_of_site` has stated it
    exit_code : of the command line, by family
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str, fix: str, **facts: object):
        super().__init__(_text(what, where, fix))
        self.what = what
        self.where = where
        self.fix = fix
        self.facts = facts

    @property
    def message(self) -> str:
        """What happened, without `where` and `fix`."""
        return self.what

    @property
    def site(self) -> str | None:
        """The site, or the sites of a place (`p1 + p2`), at which it happened; None if none is known."""
        found = self.facts.get("site")
        return None if found is None else str(found)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickling, to pass the error from one process to another."""
        return _arrived, (type(self), self.what, self.where, self.fix, self.facts)


def _text(what: str, where: str, fix: str) -> str:
    return f"{what}\n  where: {where}\n  fix:   {fix}"


def _arrived(
    family: type[LimbcliError], what: str, where: str, fix: str, facts: dict[str, Any]
) -> LimbcliError:
    error = family.__new__(family)
    LimbcliError.__init__(error, what, where=where, fix=fix, **facts)
    return error


LimbError = LimbcliError  # the name within the package


@contextlib.contextmanager
def errors_of_site(name: str | None) -> Iterator[None]:
    """Errors raised in the block carry this site, unless they carry one already; None: no site.

    >>> try:
    ...     with errors_of_site("p1 + p2"), errors_of_site("p1"):
    ...         raise MeshError("286 cells are inverted", where="layers of p10", fix="give thinner layers")
    ... except MeshError as error:
    ...     print(error.site, "|", error.where)
    p1 | site p1, layers of p10
    """
    try:
        yield
    except LimbError as error:
        if name is not None and error.site is None:
            error.facts["site"] = name
            if not re.search(rf"(^|\s){re.escape(name)}($|[\s,;:])", error.where):  # not stated there yet
                error.where = f"site {name}, {error.where}"
                error.args = (_text(error.what, error.where, error.fix),)
        raise


class CaseError(LimbError):
    """The case folder, or a file the user brought, cannot be used."""

    exit_code = 2


class MeasurementError(LimbError):
    """A measured value is missing, impossible or contradicts another."""

    exit_code = 3


class ToolError(LimbError):
    """A program or package that the work needs is missing or broken."""

    exit_code = 4


class MeshError(LimbError):
    """A surface or a volume mesh cannot be made or is not good enough."""

    exit_code = 5


class SolveError(LimbError):
    """The simulation did not reach its end."""

    exit_code = 6


class FitError(LimbError):
    """The identification did not reach a reliable result."""

    exit_code = 7


class UnforeseenError(LimbError):
    """A failure that limbcli does not foresee: a bug, reported with a file to send in."""

    exit_code = 70
