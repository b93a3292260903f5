"""Effect of the penalty contact on the force: solve the fitted model again with a stiffer contact.

A penalty contact lets the probe penetrate the skin. The penalty is a multiple of the tissue's stiffness at
rest, so where the tissue stiffens (large m, large depth) the penetration grows and the force is too low,
for which the fit compensates with a larger m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array
from limbcli.progress import SILENT, Progress
from limbcli.results import StageWriter

HARDER = 4.0  # penalty of the check, as a multiple of the model's
MATTERS = 0.05  # relative change of force above which a warning is given; below it the mesh error is larger


def write_contact_check(
    penalty: float, forces: Array, depths: Array, harder: Callable[[float], Array], writer: StageWriter, *,
    site: str | None = None, progress: Progress = SILENT,
) -> None:  # fmt: skip
    """Write `contact_check` of a fit, a line of the summary, and a warning if the change exceeds `MATTERS`.

    penalty, forces (n_levels,), depths (n_levels,) : of the fitted model
    harder : penalty -> forces (n_reached,) of the same model; raises SolveError
    site : name of the site, in a fit of several sites, each of which has its own check
    """
    found = writer.data if site is None else writer.data.setdefault("contact_check", {})
    key, at = ("contact_check", "") if site is None else (site, f"{site}: ")
    progress.event("note", text=f"the fitted model with {HARDER:g} times the contact's penalty")
    reported = {"penalty": penalty, "tried": HARDER * penalty, "depths_mm": depths}
    try:
        found_forces = harder(HARDER * penalty)
    except SolveError as error:
        found[key] = {**reported, "not_evaluated": error.what}
        writer.warnings.append(f"{at}the force lost to contact penetration was not evaluated: {error.what}")
        return
    n = len(found_forces)
    change = found_forces / np.maximum(forces[:n], 1e-9) - 1.0
    found[key] = {**reported, "depths_mm": depths[:n], "force_change_fraction": change}
    worst = int(np.argmax(np.abs(change)))
    words = f"with a contact {HARDER:g} times as stiff the force changes by {100 * change[worst]:+.1f} %"
    where = f"at {depths[worst]:.1f} mm"
    if n < len(depths):
        where += f" (evaluated down to {depths[n - 1]:.1f} mm)"
    writer.summary.append(f"{at}{words} {where}")
    if abs(change[worst]) > MATTERS:
        writer.warnings.append(
            f"{at}the probe sinks into the skin: {words} {where}, and f_kappa and m make up for it. Build "
            f"the model with --contact-penalty {HARDER * penalty:g} and fit again (FEBio may need smaller "
            "steps then)"
        )
