"""What the contact's penalty takes from the force: the fitted model once more, with a harder contact.

A penalty lets the probe sink into the skin. It is a multiple of the tissue's stiffness at rest, so
where the tissue stiffens, at a large m and deep in, the probe sinks further, the force is too low there, and
a fit makes up for that with a larger m.
"""

from __future__ import annotations

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.results import StageWriter
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.site_model.indentation_model import with_penalty

HARDER = 4.0  # times the model's penalty
MATTERS = 0.05  # of the force; below it a mesh's own doubt is larger
_TOLERANCE = 1e-4


def contact_change(model: LimbModel, forces: Array, *, progress: Progress = SILENT) -> Array:
    """By what share the harder contact changes these forces (n_levels,) of the model's levels.

    Raises
    ------
    SolveError
        If the model cannot be solved with it.
    """
    model = with_penalty(model, HARDER * model.contacts[0].penalty)
    session = ReferenceSession(model, progress=progress, tolerance=_TOLERANCE)
    try:
        harder = session.solve(model).must_points.forces
    except ArithmeticError as error:
        raise SolveError(
            f"the law leaves the range of numbers ({error})", where="contact check", fix="--no-contact-check"
        ) from error
    finally:
        session.close()
    return np.asarray(harder / np.maximum(forces, 1e-9) - 1.0)


def leave_contact_check(
    model: LimbModel, forces: Array, depths: Array, writer: StageWriter, *, site: str | None = None,
    progress: Progress = SILENT,
) -> None:  # fmt: skip
    """`contact_check` of a fit, a sentence about it, and a warning where it matters.

    site : where the fit is of several, each has a check of its own
    """
    found = writer.data if site is None else writer.data.setdefault("contact_check", {})
    key, at = ("contact_check", "") if site is None else (site, f"{site}: ")
    progress.event("note", text=f"the fitted model with {HARDER:g} times the contact's penalty")
    penalty = model.contacts[0].penalty
    reported = {"penalty": penalty, "tried": HARDER * penalty, "depths_mm": depths}
    try:
        change = contact_change(model, forces, progress=progress)
    except SolveError as error:
        found[key] = {**reported, "not_evaluated": error.what}
        writer.warnings.append(f"{at}what the contact takes from the force was not evaluated: {error.what}")
        return
    found[key] = {**reported, "force_change_fraction": change}
    worst = int(np.argmax(np.abs(change)))
    words = f"{HARDER:g} times the contact's penalty changes the force by {100 * change[worst]:+.1f} %"
    where = f"at {depths[worst]:.1f} mm"
    writer.summary.append(f"{at}{words} {where}")
    if abs(change[worst]) > MATTERS:
        writer.warnings.append(
            f"{at}the probe sinks into the skin: {words} {where}, which f_kappa and m make up for. "
            f"Build the model with --contact-penalty {HARDER * penalty:g} and fit again (FEBio may need "
            "smaller steps then)"
        )
