"""`limbcli fit CASE`."""

from __future__ import annotations

from limbcli.cli.fit_options import (
    CDeviationOpt,
    CompareElementOpt,
    CompareLawsOpt,
    ContactCheckOpt,
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
    OutOpt,
    QuietOpt,
    SiteOpt,
    SolverOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit, terminal


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
    compare_element: CompareElementOpt = False,
    templates: TemplatesOpt = None,
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
        contact_check=contact_check, templates=templates, time_limit_s=time_limit_s,
    )  # fmt: skip
    given = {"--law": law != "ogden", "--compare-laws": compare_laws}
    check_choice(
        objective, compare_element=compare_element, solver=solver, stiffness_map=stiffness_map,
        joint_only=[name for name, is_given in given.items() if is_given],
    )  # fmt: skip
    opened, folder = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    if compare_element:
        from limbcli.stages.fit_elements import compare_elements

        found = compare_elements(opened, out=folder, sites=site, options=options, progress=progress)
        emit(found, as_json=json)
    elif objective == "joint":
        from limbcli.stages.fit_joint import JointOptions, fit_joint

        joint = JointOptions(law=law, compare_laws=compare_laws, gain_deviation=gain_deviation)
        one = fit_joint(opened, out=folder, sites=site, joint=joint, options=options, progress=progress)
        emit(one, as_json=json)
    else:
        results = fit(
            opened, out=folder, sites=site, solver=solver, febio=febio, options=options, progress=progress
        )
        emit(results, as_json=json)
