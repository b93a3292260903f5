"""Versions of FEBio whose results limbcli has been compared with (docs/solvers.md)."""

from __future__ import annotations

import re
from collections.abc import Collection

FIRST, LAST = (4, 9), (4, 11)
_REACTIONS = {"Rx", "Ry", "Rz"}
_NUMBERS = re.compile(r"(\d+)\.(\d+)")


def version_caution(version: str) -> str | None:
    """What to say of a version as FEBio prints it; None of those compared, and of an unknown one.

    >>> version_caution("4.9.0"), version_caution("4.11.0.65622b536"), version_caution("unknown")
    (None, None, None)
    >>> version_caution("4.12.0").partition(":")[0]
    'FEBio 4.12.0 has not been compared with limbcli, only 4.9 to 4.11'
    """
    found = _NUMBERS.match(version)
    if found is None or FIRST <= (int(found[1]), int(found[2])) <= LAST:
        return None
    known = " to ".join(".".join(map(str, each)) for each in (FIRST, LAST))
    return (
        f"FEBio {version} has not been compared with limbcli, only {known}: check forces and displacements "
        "of one model against --solver reference"
    )


def reaction_caution(version: str, fields: Collection[str]) -> str | None:
    """What to say of reactions that an older FEBio logs for nodes; fields : of all node records.

    >>> reaction_caution("4.11.0", ["Rz"]), reaction_caution("4.9.0", ["uz"])
    (None, None)
    >>> reaction_caution("4.9.0", ["uz", "Rz"]).partition(":")[0]
    'FEBio 4.9.0 logs the force of a rigid body at each of its nodes'
    """
    found = _NUMBERS.match(version)
    if found is None or (int(found[1]), int(found[2])) >= LAST or not _REACTIONS & set(fields):
        return None
    return (
        f"FEBio {version} logs the force of a rigid body at each of its nodes: do not add up Rx, Ry, Rz of a "
        "node record that contains them, and take the force from <rigid_body_data>"
    )
