"""`limbcli fit CASE`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limbcli.cli.fit_options import (
    BoundaryCheckOpt,
    CDeviationOpt,
    CompareElementOpt,
    CompareLawsOpt,
    ContactCheckOpt,
    CycleOpt,
    GainDeviationOpt,
    IntervalsOpt,
    LawOpt,
    MaxIterationsOpt,
    ObjectiveOpt,
    StiffnessMapOpt,
    TimeLimitOpt,
    ToleranceOpt,
)
from limbcli.cli.options import (
    CaseArg,
    CKpaOpt,
    FebioOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    SiteOpt,
    SolverOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer

if TYPE_CHECKING:
    from limbcli.results import StageResult


def command(
    case: CaseArg,
    out: OutOpt = None,
    site: SiteOpt = None,
    solver: SolverOpt = "auto",
    febio: FebioOpt = None,
    c_kpa: CKpaOpt = None,
    c_deviation: CDeviationOpt = None,
    stiffness_map: StiffnessMapOpt = False,
    tolerance: ToleranceOpt = 1e-3,
    max_iterations: MaxIterationsOpt = 50,
    intervals: IntervalsOpt = True,
    time_limit_s: TimeLimitOpt = None,
    objective: ObjectiveOpt = "force",
    law: LawOpt = "ogden",
    compare_laws: CompareLawsOpt = False,
    gain_deviation: GainDeviationOpt = None,
    contact_check: ContactCheckOpt = True,
    boundary_check: BoundaryCheckOpt = True,
    cycle: CycleOpt = "last",
    compare_element: CompareElementOpt = False,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Identify f_kappa and m of each site from its force-depth curve (c from SWE)."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.fit import FitOptions, check_choice, fit

    options = FitOptions(
        c_kpa=c_kpa, c_deviation=c_deviation, stiffness_map=stiffness_map, tolerance=tolerance,
        max_iterations=max_iterations, intervals=intervals, gain_deviation=gain_deviation,
        contact_check=contact_check, boundary_check=boundary_check, cycle=cycle, templates=templates,
        time_limit_s=time_limit_s,
    )  # fmt: skip
    given = {"--law": law != "ogden", "--compare-laws": compare_laws}
    check_choice(
        objective, compare_element=compare_element, solver=solver, stiffness_map=stiffness_map,
        joint_only=[name for name, is_given in given.items() if is_given],
        options=options, febio=febio,
    )  # fmt: skip
    opened, folder = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    results: StageResult | list[StageResult]
    with one_writer(folder, wait=not no_wait, progress=progress):
        if compare_element:
            from limbcli.stages.fit_elements import compare_elements

            results = compare_elements(opened, out=folder, sites=site, options=options, progress=progress)
        elif objective == "joint":
            from limbcli.stages.fit_joint import JointOptions, fit_joint

            joint = JointOptions(law=law, compare_laws=compare_laws, gain_deviation=gain_deviation)
            results = fit_joint(
                opened, out=folder, sites=site, joint=joint, options=options, progress=progress
            )
        else:
            results = []
            if objective == "force":
                results += fit(
                    opened, out=folder, sites=site, solver=solver, febio=febio, options=options,
                    progress=progress,
                )  # fmt: skip
            if objective == "states" or any(each.states for each in opened.selected(site)):
                from limbcli.stages.fit_states import StatesOptions, fit_states

                states = StatesOptions(law=law, gain_deviation=gain_deviation)
                results += fit_states(
                    opened, out=folder, sites=site, states=states, options=options, progress=progress
                )
    emit(results, as_json=json)
