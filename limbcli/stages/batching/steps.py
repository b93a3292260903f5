"""The stages of one site as run by a batch: the inputs and the call of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.progress import Progress
from limbcli.provenance.requested_options import Requested, options_of
from limbcli.reporting.outcome import SITE_STAGES
from limbcli.results import stage_folder
from limbcli.solvers import identity
from limbcli.stages.batching.outcome import BatchOptions

FIT_STATES = "fit-states"  # run after the other stages, for a site that has states


@dataclass(frozen=True, eq=False)
class SiteStep:
    """parts : what the stage depends on besides the case and earlier results, which its own result records;
    paths are hashed by their content
    """

    stage: str
    parts: Sequence[object]
    work: Callable[[], object]


def site_steps(
    case: Case, name: str, options: BatchOptions, requested: Mapping[str, Requested], *, out: Path,
    progress: Progress,
) -> list[SiteStep]:  # fmt: skip
    """The steps in order. `requested`: for each stage, the options of its last manual call."""
    from limbcli.stages.build_feb import TissueOptions, build_feb
    from limbcli.stages.fit import FitOptions, fit
    from limbcli.stages.mesh import MeshRequest, mesh
    from limbcli.stages.run import RunOptions, run

    common: dict[str, Any] = {"out": out, "progress": progress, "sites": [name]}
    solver: dict[str, Any] = {"solver": options.solver, "febio": options.febio}
    meshed = {**requested["mesh"], **({"element": options.element} if options.element else {})}
    mesh_request = options_of(MeshRequest, meshed)
    tissue, ran, fitted = (requested[each] for each in SITE_STAGES[1:])
    templates, of_model = templates_of(options, tissue)
    fit_options = options_of(FitOptions, fitted)
    if options.templates:
        fit_options = replace(fit_options, templates=templates)
    study = stage_folder(out, "mesh-study", name) / "mesh-study.json"

    steps = [
        SiteStep("mesh", parts_of(meshed), lambda: mesh(case, options=mesh_request, **common)),
        SiteStep(
            "build-feb",
            (*of_model, *parts_of(tissue)),
            lambda: build_feb(case, options=options_of(TissueOptions, tissue), templates=templates, **common),
        ),
        SiteStep(
            "run",
            (identity(options.solver, options.febio), *parts_of(ran)),
            lambda: run(case, options=options_of(RunOptions, ran), **solver, **common),
        ),
        SiteStep(
            "fit",
            (*([study] if study.is_file() else []), *parts_of(fitted)),
            lambda: fit(case, options=fit_options, **solver, **common),
        ),
    ]
    if case.site(name).states:
        from limbcli.stages.fit_states import fit_states

        several = requested.get(FIT_STATES, {})
        parts = (*steps[-1].parts, *parts_of(several))
        of_states = options_of(FitOptions, several)
        steps.append(SiteStep(FIT_STATES, parts, lambda: fit_states(case, options=of_states, **common)))
    return steps


def templates_of(options: BatchOptions, requested: Requested) -> tuple[Path | None, list[Path]]:
    """The folder of templates, and its part that a model depends on, where there is one."""
    folder = options.templates or path_of(requested.get("templates"))
    return folder, [folder / "feb"] if folder and (folder / "feb").is_dir() else []


def parts_of(requested: Requested) -> tuple[object, ...]:
    """Requested options as parts of a key."""
    return (sorted(requested.items()),) if requested else ()


def path_of(text: str | None) -> Path | None:
    """Path of an option that was stored as text."""
    return Path(text) if text else None
