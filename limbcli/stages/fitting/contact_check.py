"""What the contact's penalty takes from the force: the fitted model once more, with a harder contact.

A penalty lets the probe sink into the skin. It is a multiple of the tissue's stiffness at rest, so
where the tissue stiffens, at a large m and deep in, the probe sinks further, the force is too low there, and
a fit makes up for that with a larger m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.results import StageWriter
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.site_model.indentation_model import with_penalty

HARDER = 4.0  # times the model's penalty
MATTERS = 0.05  # of the force; below it a mesh's own uncertainty is larger
_TOLERANCE = 1e-4
# Of the forces at play: what will do where iterations go round, as they do where fibres begin to be
# stretched. On a limb with fibres it moved the force of one level of eight by 0.06 %.
_STALLED = 1e-2


def forces_with_penalty(
    model: LimbModel, penalty: float, *, like: ReferenceSession | None = None, threads: int = 2,
    progress: Progress = SILENT,
) -> Array:  # fmt: skip
    """Forces (n_reached,) N at the model's levels with another penalty of its contact.

    like : a session that has solved the model, whose levels lead this one's. Those that are not reached soon
        from there are left out, with all beyond them: a difference need not have every level

    Raises
    ------
    SolveError
        If the model cannot be solved with it.
    """
    model = with_penalty(model, penalty)
    session = ReferenceSession(
        model, progress=progress, threads=threads, tolerance=_TOLERANCE, stalled=_STALLED
    )
    try:
        if like is None:
            return session.solve(model).must_points.forces
        session.start_like(like)
        return session.solve(model, required=1, hoped=0).must_points.forces
    except ArithmeticError as error:
        raise SolveError(
            f"the law overflows ({error})", where="contact check", fix="--no-contact-check"
        ) from error
    finally:
        session.close()


def write_contact_check(
    penalty: float, forces: Array, depths: Array, harder: Callable[[float], Array], writer: StageWriter, *,
    site: str | None = None, progress: Progress = SILENT,
) -> None:  # fmt: skip
    """`contact_check` of a fit, a sentence about it, and a warning where it matters.

    penalty, forces (n_levels,), depths (n_levels,) : of the model that was fitted
    harder : the same model's forces (n_reached,) with the penalty it is called with; raises SolveError
    site : where the fit is of several, each has a check of its own
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
    words = f"{HARDER:g} times the contact's penalty changes the force by {100 * change[worst]:+.1f} %"
    where = f"at {depths[worst]:.1f} mm"
    if n < len(depths):
        where += f" (evaluated down to {depths[n - 1]:.1f} mm)"
    writer.summary.append(f"{at}{words} {where}")
    if abs(change[worst]) > MATTERS:
        writer.warnings.append(
            f"{at}the probe penetrates the skin: {words} {where}, which f_kappa and m "
            f"compensate for. Build the model with --contact-penalty {HARDER * penalty:g} and fit again "
            f"(FEBio may need "
            "smaller steps then)"
        )
