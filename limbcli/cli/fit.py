"""`limbcli fit CASE`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from limbcli.api.call import at_work
from limbcli.options import CASE, Option
from limbcli.progress import Progress
from limbcli.results import StageResult


def fit_by_objective(
    case: Annotated[Path, CASE],
    *,
    objective: Annotated[
        Literal["force", "joint", "states"],
        Option(
            "What to fit. force: the force-depth curve of each site, as in the paper. joint: depths and wave "
            "speeds of all sites, which share one tissue. states: the same for the states of one site.",
            before="gain_deviation_fraction",
        ),
    ] = "force",
    compare_element: Annotated[
        bool, Option("Compare tet4 and tet10 on the same mesh.", before="templates")
    ] = False,
    law: str,
    compare_laws: bool,
    out: Path | None,
    sites: list[str] | None,
    solver: str,
    febio: Path | None,
    c_deviation_fraction: float | None,
    gain_deviation_fraction: float | None,
    wait: bool,
    progress: Progress,
    **others: Any,
) -> StageResult | list[StageResult]:
    """Identify f_kappa and m of each site from its force-depth curve (c from SWE)."""
    from limbcli.stages.fit import FitOptions, check_choice, fit

    options = FitOptions(c_deviation=c_deviation_fraction, gain_deviation=gain_deviation_fraction, **others)
    given = {"--law": law != "ogden", "--compare-laws": compare_laws}
    check_choice(
        objective, compare_element=compare_element, solver=solver, stiffness_map=options.stiffness_map,
        joint_only=[name for name, is_given in given.items() if is_given],
        options=options, febio=febio,
    )  # fmt: skip
    with at_work(case, out, wait=wait, progress=progress) as work:
        opened, folder = work.case, work.out
        if compare_element:
            from limbcli.stages.fit_elements import compare_elements

            return compare_elements(opened, out=folder, sites=sites, options=options, progress=progress)
        if objective == "joint":
            from limbcli.stages.fit_joint import JointOptions, fit_joint

            joint = JointOptions(law=law, compare_laws=compare_laws, gain_deviation=gain_deviation_fraction)
            return fit_joint(opened, out=folder, sites=sites, joint=joint, options=options, progress=progress)
        results = []
        if objective == "force":
            results += fit(
                opened, out=folder, sites=sites, solver=solver, febio=febio, options=options,
                progress=progress,
            )  # fmt: skip
        if objective == "states" or any(each.states for each in opened.selected(sites)):
            from limbcli.stages.fit_states import StatesOptions, fit_states

            states = StatesOptions(law=law, gain_deviation=gain_deviation_fraction)
            results += fit_states(
                opened, out=folder, sites=sites, states=states, options=options, progress=progress
            )
        return results
