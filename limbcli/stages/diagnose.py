"""diagnose: where model and measurement disagree, what is missing, and what the data cannot determine.

Numerical effects are assessed first, by changing the mesh, cut and contact. Candidate effects are then tested
on a working mesh (coarse, quadratic), corrected to the site's own mesh where this is available. Measurements
of the same place (another orientation, a repeat) are diagnosed jointly, as they share the tissue.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.config import one_blas_thread
from limbcli.diagnosis.drainage import DrainageSolver
from limbcli.diagnosis.explanations import decisions, verdict
from limbcli.diagnosis.explanations.conclusions import Diagnosis
from limbcli.diagnosis.explanations.residuals import force_jump
from limbcli.diagnosis.explanations.sentences import sentences
from limbcli.diagnosis.forward_model.measurement_menu import known
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA
from limbcli.diagnosis.mesh_error.numerical_checks import Intervention, large_uncertainty
from limbcli.diagnosis.prepare import STAGE, Prepared, WorkingMesh, prepare, turned_by_90
from limbcli.diagnosis.written_model import write_diagnosed
from limbcli.diagnosis.written_result import (
    candidates_picture,
    diagnosed_force,
    diagnosis_json,
    gap_picture,
    sizes_of,
    sizes_picture,
)
from limbcli.effects import EFFECTS, Effect, effect
from limbcli.effects.effect import NUMERICAL
from limbcli.effects.own_file import effect_of_file
from limbcli.errors import CaseError, LimbError, errors_of_site
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.provenance.requested_options import requested_by_options
from limbcli.provenance.staleness import check_earlier, note_earlier
from limbcli.results import StageResult, open_stage, plain, read_result
from limbcli.site_model.cycle_words import cycle_facts
from limbcli.site_model.segmented_limb import site_position
from limbcli.site_model.site_levels import all_levels_of

_SAME_PLACE = 2.0  # mm, largest distance of two sites at the same place


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions:
    """Options of `diagnose`.

    effects : names of the effects to try (empty: all); effect_file : file with a user-defined effect, which
    is always tried; size, far_size : mm, edges of the working mesh (size None: from the tissue thickness)
    separate : diagnose every site separately, including those that share a place
    measured : additionally measured numbers (see `measurement_menu.known`), for the first site of each place
    solver : for draining tissue, which only FEBio simulates. "auto": FEBio if found, and if the force falls
    in a hold; "febio": wherever holds were recorded; "reference": never. febio : path of its binary
    """

    effects: tuple[str, ...] = ()
    effect_file: Path | None = None
    max_effects: int = 2
    seed: int = 7
    size: float | None = None
    far_size: float = 14.0
    templates: Path | None = None
    interventions: bool = True
    separate: bool = False
    measured: Mapping[str, float] = field(default_factory=dict)
    solver: str = "auto"
    febio: Path | None = None

    def requested(self) -> dict[str, Any]:
        """Options to repeat this run, except the solver, which is chosen again."""
        usual = type(self)()
        return requested_by_options(replace(self, solver=usual.solver, febio=usual.febio))

    @property
    def mesh(self) -> WorkingMesh:
        return WorkingMesh(self.size, self.far_size, self.interventions)


def diagnose(
    case: Case, *, out: Path, sites: list[str] | None = None, options: DiagnoseOptions = DiagnoseOptions(),
    progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Diagnose each site. Writes diagnosis.json, figures and the model with the chosen effects.

    Raises as `limbcli.diagnose`.
    """
    draining = DrainageSolver.chosen(options.solver, options.febio)
    effects = chosen_effects(options)
    results: list[StageResult] = []
    check_earlier(case, out, case.selected(sites))
    for group in places(case, case.selected(sites), out=out, separate=options.separate):
        together = " + ".join(site.name for site in group)
        progress.event("stage", name=STAGE, site=together)
        with errors_of_site(together), one_blas_thread():
            results += _Diagnosed(
                case=case, sites=group, out=out, effects=effects, options=options, draining=draining,
                progress=progress, inputs=CaseInputs(case),
            ).run()  # fmt: skip
    return results


def places(case: Case, sites: Sequence[Site], *, out: Path, separate: bool = False) -> list[list[Site]]:
    """Sites grouped by place, in the order of the case.

    A site whose position is unknown (a marker that was not found) forms its own group; its diagnosis reports
    the error.
    """
    if separate or len(sites) < 2:
        return [[site] for site in sites]
    segmented = read_result(out, "segment")
    groups: list[tuple[np.ndarray, list[Site]]] = []
    for site in sites:
        try:
            at = np.array(site_position(site, segmented))
        except CaseError:
            at = np.full(3, np.nan)  # never near another place
        near = [group for place, group in groups if np.linalg.norm(place - at) < _SAME_PLACE]
        if near:
            near[0].append(site)
        else:
            groups.append((at, [site]))
    return [group for _, group in groups]


def chosen_effects(options: DiagnoseOptions) -> tuple[Effect, ...]:
    """The named effects, or all, and the user-defined effect of a file, which is always tried."""
    own = () if options.effect_file is None else (effect_of_file(options.effect_file, EFFECTS),)
    if not options.effects:
        return (*EFFECTS, *own)
    named = [effect(name, (*EFFECTS, *own)) for name in options.effects]
    for each in named:
        if each.kind == NUMERICAL:
            raise CaseError(
                f"{each.name!r} cannot be selected: the effects of mesh, cut and contact are always "
                f"assessed first",
                where="--effects",
                fix="leave it out",
            )
    return (*named, *(each for each in own if each not in named))


@dataclass(frozen=True, kw_only=True)
class _Diagnosed:
    """Diagnosis of the measurements of one place, from preparation to results."""

    case: Case
    sites: Sequence[Site]
    out: Path
    effects: Sequence[Effect]
    options: DiagnoseOptions
    draining: DrainageSolver | None
    progress: Progress
    inputs: CaseInputs

    def run(self) -> list[StageResult]:
        prepared: list[Prepared] = []
        inputs = self.inputs
        extras, options = known(self.options.measured), self.options
        effects = {each.name: each for each in self.effects if each.kind != NUMERICAL}
        with ExitStack() as opened:
            for site in self.sites:
                with errors_of_site(site.name):
                    one = prepare(
                        inputs.case, inputs.site(site), effects, out=self.out, mesh=options.mesh,
                        extras=[] if prepared else extras, draining=self.draining, progress=self.progress,
                    )  # fmt: skip
                opened.callback(one.simulations.close)
                prepared.append(one)
            forward_model = SiteForwardModel([each.curves for each in prepared])
            forward_model.settle_noise()
            if len(prepared) == 1 and (self.out / "segment" / "segment.json").is_file():
                forward_model.turned = lambda: self._turned(prepared[0])
            found = verdict.diagnose(
                forward_model, max_effects=options.max_effects, seed=options.seed, progress=self.progress
            )
            return [self._write(found, forward_model, prepared, k) for k in range(len(prepared))]

    def _turned(self, prepared: Prepared) -> SiteCurves:
        """Curves with the probe turned by 90 degrees; a warning is added if they cannot be simulated."""
        try:
            return turned_by_90(
                self.inputs.case, prepared, out=self.out, mesh=self.options.mesh, progress=self.progress
            )
        except LimbError as error:
            text = f"the probe turned by 90 degrees is not among the proposed measurements: {error.what}"
            prepared.notes.warnings.append(text)
            raise

    def _write(
        self, found: Diagnosis, forward_model: SiteForwardModel, all_: Sequence[Prepared], k: int
    ) -> StageResult:
        """Write one site's results: the verdict of its place, and the site's own figures and model."""
        mine = all_[k]
        with open_stage(self.out, STAGE, subject=self.case.subject, site=mine.site.name) as writer:
            writer.data["asked"] = self.options.requested()
            self.inputs.into(writer)
            for each in all_:  # all were diagnosed jointly
                note_earlier(self.out, each.site, writer)
            writer.warnings.extend(mine.notes.warnings)
            if mine.simulations.in_part:
                writer.warnings.append(_in_part(mine.simulations.in_part))
            for name, why in mine.curves.changes.not_simulated.items():
                writer.warnings.append(f"{name} was evaluated at the deformation without it: {why}")
            if forward_model.not_simulated:
                names = ", ".join(sorted(" + ".join(each) for each in forward_model.not_simulated))
                writer.warnings.append(
                    f"the simulations used up the diagnosis's work budget; fitted by sensitivities only: "
                    f"{names}"
                )
            warning = large_uncertainty(mine.interventions)
            writer.warnings.extend([warning] if warning else [])
            content = _content(found, forward_model, all_, mine)
            repeated = cycle_facts(mine.site, all_levels_of(mine.site))
            if repeated:
                content |= {"cycles": repeated, "sentences": [*content["sentences"], *repeated["sentences"]]}
            path = writer.file("diagnosis", "diagnosis.json")
            path.write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
            writer.data.update(mine.notes.data)
            writer.data.update(content)
            writer.data["n_solves"] = mine.simulations.n_solves
            writer.summary.extend(content["sentences"])
            gap_picture(found, [each.curves.site for each in all_], writer.file("gap", "gap.png"))
            candidates_picture(found, writer.file("candidates", "candidates.png"))
            sizes_picture(found, sizes_of(forward_model, mine.curves.site), writer.file("sizes", "sizes.png"))
            write_diagnosed(
                found, forward_model, mine, writer, out=self.out, number=k, templates=self.options.templates
            )
        return writer.result


def _content(
    found: Diagnosis, forward_model: SiteForwardModel, all_: Sequence[Prepared], mine: Prepared
) -> dict[str, Any]:
    matter = [each for each in mine.interventions if each.deviations > decisions.MATTERS_SD]
    moved = ", ".join(each.name for each in matter if each.name != "locking")
    lines = sentences(found)
    lines[1:1] = [_locked(each) for each in matter if each.name == "locking"]
    jump = force_jump(forward_model.data, found.base, explained=found.shrink[0].chi2 - found.shrink[-1].chi2)
    if jump is not None and found.verdict != "adequate":
        lines.insert(1, jump.sentence)
    if moved:
        lines.insert(2, f"Numerical uncertainty counted as noise: {moved} (see `numerical`).")
    return {
        **diagnosis_json(found, mine.curves.site, forward_model),
        "sites": [each.site.name for each in all_],
        "numerical": [
            {"name": i.name, "note": i.note, "largest_change_in_deviations": i.deviations,
             "matters": i in matter, "log_force_change": i.log_force, "share_uncertain": i.left}
            for i in mine.interventions
        ],
        "f_kappa_held_at": F_KAPPA,
        "tissue_force": diagnosed_force(found, mine.curves),
        "not_simulated": sorted(forward_model.not_simulated),
        "solved_in_part_mm": mine.simulations.in_part,
        "force_jump": None if jump is None else {"size_n": jump.size, "level": jump.level},
        "drainage": mine.notes.data.get("drainage"),
        "sentences": lines,
    }  # fmt: skip


def _in_part(reached: Mapping[str, float]) -> str:
    parts = "; ".join(f"{name}: {depth:.1f} mm" for name, depth in reached.items())
    return (
        f"not solved to the depth of the readings; their curves were extrapolated along those of others: "
        f"{parts}"
    )


def _locked(found: Intervention) -> str:
    times = float(np.exp(-np.min(found.log_force)))
    return (
        f"LOCKING: with the linear elements of the site's own run the force is up to {times:.2f} times too "
        "high; this is due to the mesh, not the tissue. Diagnosed with quadratic elements."
    )
