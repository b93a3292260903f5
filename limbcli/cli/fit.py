"""`limbcli fit CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.options import (
    CaseArg,
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
    c_kpa: Annotated[
        float | None,
        typer.Option("--c-kpa", help="c = 2 mu by hand; default: from SWE at level 0.", show_default=False),
    ] = None,
    c_deviation: Annotated[
        float | None,
        typer.Option(
            "--c-deviation-fraction", help="Standard deviation of c, relative; default: from the SWE noise.",
            show_default=False,
        ),
    ] = None,
    stiffness_map: Annotated[
        bool, typer.Option("--stiffness-map", help="c element by element, from the SWE map of level 0.")
    ] = False,
    tolerance: Annotated[float, typer.Option(help="Of cost and parameters, relative.")] = 1e-3,
    max_iterations: Annotated[int, typer.Option(min=1, help="Of each step.")] = 50,
    intervals: Annotated[bool, typer.Option(help="95 % intervals by profile likelihood.")] = True,
    time_limit_s: Annotated[
        float | None, typer.Option("--time-limit-s", help="Of each FEBio run.", show_default=False)
    ] = None,
    objective: Annotated[
        str,
        typer.Option(help="force: the paper's, site by site. joint: depth and SWE; sites share the tissue."),
    ] = "force",
    law: Annotated[
        str,
        typer.Option(help="Joint only: ogden | mooney-rivlin | neo-hooke | two-term-ogden | holmes-mow."),
    ] = "ogden",
    compare_laws: Annotated[
        bool, typer.Option("--compare-laws", help="Joint only: every law, by the error of left-out levels.")
    ] = False,
    gain_deviation: Annotated[
        float | None,
        typer.Option(
            "--gain-deviation-fraction",
            help="Numerical error of the force to allow for; default: mesh study, else by element and size.",
            show_default=False,
        ),
    ] = None,
    compare_element: Annotated[
        bool, typer.Option("--compare-element", help="tet4 and tet10 side by side on the same mesh.")
    ] = False,
    templates: TemplatesOpt = None,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:  # fmt: skip
    """Identify f_kappa and m of each site from its force-depth curve (c from SWE)."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.fit import FitOptions, check_choice, fit

    options = FitOptions(
        c_kpa=c_kpa, c_deviation=c_deviation, stiffness_map=stiffness_map, tolerance=tolerance,
        max_iterations=max_iterations, intervals=intervals, gain_deviation=gain_deviation,
        templates=templates, time_limit_s=time_limit_s,
    )  # fmt: skip
    given = {
        "--law": law != "ogden",
        "--compare-laws": compare_laws,
    }
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
