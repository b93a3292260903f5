"""Registry of all laws by name. To add a law, create a module in this package and list it here.

Laws defined outside the package are added by `register`.
"""

from __future__ import annotations

from limbcli.errors import SolveError
from limbcli.materials import (
    active_contraction,
    fiber,
    holmes_mow,
    mooney_rivlin,
    neo_hooke,
    ogden,
    ogden_uncoupled,
)
from limbcli.materials.law import Law

WRAPPERS = ("mixture", "viscoelastic", "prestrain")  # laws that wrap other laws: see `program`
LAWS: dict[str, Law] = {
    each.LAW.name: each.LAW
    for each in (ogden, ogden_uncoupled, mooney_rivlin, neo_hooke, holmes_mow, fiber, active_contraction)
}
_THREE_FIELD = ("hex8", "penta6")


def is_three_field(law: str, kind: str) -> bool:
    """Whether FEBio by default keeps the pressure constant in each cell of a kind (three-field element).

    In hexahedra and wedges whose material is itself an uncoupled law, not a mixture or wrapper of one.

    Source: FEBio 4.11, FESolidDomainFactory::CreateDomain.

    >>> is_three_field("mooney_rivlin", "hex8"), is_three_field("mixture", "hex8")
    (True, False)
    """
    return kind in _THREE_FIELD and law in LAWS and LAWS[law].uncoupled


def register(law: Law) -> None:
    """Register a law defined outside the package under its name, for this process.

    Raises SolveError if its name, or FEBio's name for it, is already in use.
    """
    by_febio = {each.febio.material: each.name for each in LAWS.values() if each.febio is not None}
    taken = law.name if law.name in LAWS or law.name in WRAPPERS else None
    if law.febio is not None:
        taken = by_febio.get(law.febio.material, taken)
    if taken is not None:
        raise SolveError(
            f"the law {law.name!r} cannot be added: there is {taken!r}",
            where="laws of limbcli.materials",
            fix="give it, and its name in FEBio, another name",
        )
    LAWS[law.name] = law
