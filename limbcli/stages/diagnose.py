"""diagnose: where model and measurement disagree, what is missing, and what the data cannot tell.

Numerical effects first, by intervention on the mesh; then candidate effects on a working mesh
(coarse, quadratic), tied to the site's own mesh where that was run. Every simulation is kept in
`<out>/diagnose/.work-<site>`, so that an interrupted diagnosis goes on where it was.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.diagnostics.engine import diagnose as diagnose_bench
from limbcli.diagnostics.sentences import sentences
from limbcli.diagnostics.verdict import Diagnosis
from limbcli.effects import EFFECTS, Effect, effect
from limbcli.effects.reading import true_depth
from limbcli.errors import CaseError, LimbError
from limbcli.feb.settings import least_level, schedule
from limbcli.feb.write import write_feb
from limbcli.files import sha256
from limbcli.measurement.elastography import read_maps
from limbcli.measurement.indentation import read_levels
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.model import LimbModel
from limbcli.model_io import load_model, save_model
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage, plain, read_result
from limbcli.stages.build_feb import tissue_stiffness
from limbcli.stages.diagnosis_bench import SiteBench
from limbcli.stages.diagnosis_curves import CurveBook, Windows
from limbcli.stages.diagnosis_data import ModelError, SiteData, site_data
from limbcli.stages.diagnosis_numerics import F_KAPPA, MATTERS, USUAL_C, Intervention, Numerics
from limbcli.stages.diagnosis_report import candidates_picture, diagnosis_json, gap_picture
from limbcli.stages.indentation_model import indentation_model, starting_depth
from limbcli.stages.mesh import read_limb, site_position
from limbcli.units import mpa_from_kpa

STAGE = "diagnose"
_N_DEPTHS = 7
_BEYOND = 1.12


@dataclass(frozen=True)
class DiagnoseOptions:
    """effects : names to try (empty: all); size, far_size : mm, of the working mesh's edges."""

    effects: tuple[str, ...] = ()
    effect_file: Path | None = None
    max_effects: int = 3
    seed: int = 7
    size: float = 5.0
    far_size: float = 14.0
    templates: Path | None = None
    interventions: bool = True


def diagnose(
    case: Case, *, out: Path, sites: list[str] | None = None, options: DiagnoseOptions = DiagnoseOptions(),
    progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Diagnose each site. Leaves diagnosis.json, pictures and the model with what was added.

    Raises
    ------
    CaseError
        If `segment` has not been run, or an effect is not known.
    MeasurementError
        If the levels cannot be used.
    SolveError, FitError
        If the model without effects cannot be solved or fitted.
    """
    effects = chosen_effects(options)
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            _Site(case, site, out, writer, effects, options, progress).all()
        assert writer.result is not None
        results.append(writer.result)
    return results


def chosen_effects(options: DiagnoseOptions) -> tuple[Effect, ...]:
    """Those named, or all; with a user's own from a file."""
    known = EFFECTS
    if options.effect_file is not None:
        known = (*known, load_effect(options.effect_file))
    if not options.effects:
        return known
    return tuple(effect(name, known) for name in options.effects)


def load_effect(path: Path) -> Effect:
    """The `EFFECT` of a Python file.

    Raises
    ------
    CaseError
        If the file cannot be run or holds no effect.
    """
    fix = "write a file like those in limbcli/effects, with `EFFECT = Effect(...)`"
    spec = importlib.util.spec_from_file_location(path.stem, path) if path.is_file() else None
    if spec is None or spec.loader is None:
        raise CaseError(f"there is no effect file {path}", where="--effect-file", fix=fix)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (ImportError, SyntaxError, NameError, TypeError, ValueError, AttributeError) as error:
        raise CaseError(f"the effect file does not run ({error})", where=str(path), fix=fix) from error
    found = getattr(module, "EFFECT", None)
    if not isinstance(found, Effect):
        raise CaseError("the effect file holds no EFFECT", where=str(path), fix=fix)
    return found


class _Site:
    """One site on its way through the diagnosis."""

    def __init__(
        self, case: Case, site: Site, out: Path, writer: StageWriter, effects: Sequence[Effect],
        options: DiagnoseOptions, progress: Progress,
    ):  # fmt: skip
        self.case, self.site, self.out, self.writer = case, site, out, writer
        self.effects, self.options, self.progress = effects, options, progress
        self.work = out / STAGE / f".work-{site.name}"
        self.work.mkdir(parents=True, exist_ok=True)
        self.levels = read_levels(site.levels)
        self.windows = Windows()
        writer.used("levels", site.levels)

    def all(self) -> None:
        book = self._book()
        try:
            numerics = Numerics(
                self.case, self.site, self.levels, book, out=self.out, size=self.options.size,
                writer=self.writer, progress=self.progress,
            )  # fmt: skip
            tie = numerics.tie()
            interventions = numerics.interventions() if self.options.interventions else []
            site = self._data(numerics.noise(tie, interventions))
            bench = SiteBench(site, book, self.effects, tie=tie, progress=self.progress)
            found = diagnose_bench(
                bench, max_effects=self.options.max_effects, seed=self.options.seed, progress=self.progress
            )
            self._leave(found, site, bench, interventions)
            self.writer.data["n_solves"] = book.n_solves
        finally:
            book.close()

    # ------------------------------------------------------------ model

    def _book(self) -> CurveBook:
        deepest = _BEYOND * float(np.nanmax(self.levels.depth))
        depths = deepest / _N_DEPTHS * np.r_[0.5, np.arange(1, _N_DEPTHS + 1)]
        try:
            c, source = tissue_stiffness(self.levels, self.site)
        except LimbError:
            c, source = USUAL_C, "a usual value (level 0 has no shear-wave speed)"
        self.writer.data["c_reference_source"] = source
        return CurveBook(
            self._working_mesh(), depths.tolist(), c=c, f_kappa=F_KAPPA, windows=self.windows, keep=self.work,
            density_kg_per_m3=self.site.density_kg_per_m3, progress=self.progress,
        )  # fmt: skip

    def _working_mesh(self) -> LimbModel:
        """A coarse mesh of the site; without surfaces (no `segment`), the site's own."""
        own = self.out / "mesh" / self.site.name / "model.npz"
        if not (self.out / "segment" / "segment.json").is_file() and own.is_file():
            self.writer.warnings.append("there are no surfaces: the site's own mesh is the working mesh")
            return load_model(own)
        segmented = read_result(self.out, "segment")
        surfaces = [sha256(path) for path in sorted(segmented.folder.glob("*.ply"))]
        place = site_position(self.site, segmented)
        recipe = [surfaces, place, self.site.long_axis, vars(self.case.probe), self.case.model.margin,
                  self.options.size, self.options.far_size]  # fmt: skip
        text = json.dumps(plain(recipe))
        kept, key = self.work / "model.npz", self.work / "model.json"
        if kept.is_file() and key.is_file() and key.read_text(encoding="utf-8") == text:
            return load_model(kept)
        self.progress.event("note", text="making the working mesh")
        probe = ProbeShape(self.case.probe.length, self.case.probe.width, self.case.probe.edge_radius)
        sizes = Sizes(under_probe=self.options.size, far=self.options.far_size)
        meshing = MeshOptions(element="tet10", margin=self.case.model.margin, sizes=sizes)
        limb = read_limb(segmented)
        model = site_model(limb, place, self.site.long_axis, probe, meshing, name=self.site.name).model
        save_model(model, kept)
        key.write_text(text, encoding="utf-8")
        return model

    def _data(self, model_error: Sequence[ModelError]) -> SiteData:
        maps = None
        if self.site.swe_maps is not None:
            maps = read_maps(self.site.swe_maps, len(self.levels))
            self.writer.used("swe maps", self.site.swe_maps)
        return site_data(
            self.site.name, self.levels, self.site.noise, windows=self.windows, maps=maps,
            model_error=model_error,
        )  # fmt: skip

    # ------------------------------------------------------------ what is left

    def _leave(
        self, found: Diagnosis, site: SiteData, bench: SiteBench, interventions: list[Intervention]
    ) -> None:
        writer = self.writer
        content = diagnosis_json(found, site, bench.effects)
        content["numerical"] = [
            {"name": i.name, "note": i.note, "largest_change_in_deviations": i.deviations,
             "matters": i.deviations > MATTERS, "log_force_change": i.log_force}
            for i in interventions
        ]  # fmt: skip
        content["f_kappa_held_at"] = F_KAPPA
        lines = sentences(found)
        moved = [i.name for i in interventions if i.deviations > MATTERS]
        if moved:
            lines.insert(2, f"Numerical doubt counted as noise: {', '.join(moved)} (see `numerical`).")
        content["sentences"] = lines
        path = writer.file("diagnosis", "diagnosis.json")
        path.write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
        writer.data.update(content)
        writer.summary.extend(lines[:10])
        gap_picture(found, site, writer.file("gap", "gap.png"))
        candidates_picture(found, writer.file("candidates", "candidates.png"))
        self._write_model(found, site, bench)

    def _write_model(self, found: Diagnosis, site: SiteData, bench: SiteBench) -> None:
        """The site's own model with what was added and the refitted parameters, for FEBio."""
        path = self.out / "mesh" / self.site.name / "model.npz"
        if not path.is_file():
            self.writer.warnings.append("no .feb was written: the site has not been meshed (limbcli mesh)")
            return
        fitted = found.final
        effects = [bench.effects[name] for name in fitted.explanation]
        points = bench._points(effects, fitted)
        reading = bench.reading(fitted.explanation, fitted.values, points)
        curves = bench.curves(
            mpa_from_kpa(fitted.values["c_kpa"]),
            fitted.values["m"],
            fitted.explanation,
            fitted.values,
            points,
        )
        depth = np.unique(np.round(true_depth(curves, site.protocol.depth, reading), 3))
        depths = [float(d) for d in depth if d > 2 * least_level()]
        meshed = load_model(path)
        plan = schedule(depths, start=starting_depth(meshed, depths[0]))
        c = mpa_from_kpa(fitted.values["c_kpa"])
        model = indentation_model(meshed, plan, c=c, f_kappa=F_KAPPA, m=fitted.values["m"])
        for each, point in zip(effects, points, strict=True):
            model = each.apply(model, {**each.null, **fitted.values, **point})
        write_feb(model, self.writer.file("feb", "diagnosed.feb"), self.options.templates)
