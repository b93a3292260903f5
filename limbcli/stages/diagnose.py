"""diagnose: where model and measurement disagree, what is missing, and what the data cannot tell.

Numerical effects first, by intervention on the mesh; then candidate effects on a working mesh
(coarse, quadratic), tied to the site's own mesh where that was run. Every simulation is kept in
`<out>/diagnose/.work-<site>`, so that an interrupted diagnosis goes on where it was.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from limbcli.case import Case, Site
from limbcli.diagnostics.engine import diagnose as diagnose_bench
from limbcli.diagnostics.sentences import sentences
from limbcli.diagnostics.verdict import Diagnosis
from limbcli.effects import EFFECTS, Effect, effect
from limbcli.effects.reading import Curves, true_depth
from limbcli.errors import CaseError, LimbError
from limbcli.feb.settings import least_level, schedule
from limbcli.feb.write import write_feb
from limbcli.files import sha256
from limbcli.measurement.elastography import read_maps
from limbcli.measurement.indentation import Levels, read_levels
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.model import Array, LimbModel
from limbcli.model_io import load_model, save_model
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage, plain, read_result
from limbcli.stages.build_feb import tissue_stiffness
from limbcli.stages.diagnosis_bench import SiteBench
from limbcli.stages.diagnosis_curves import CurveBook, Windows
from limbcli.stages.diagnosis_data import SiteData, site_data
from limbcli.stages.diagnosis_report import candidates_picture, diagnosis_json, gap_picture
from limbcli.stages.indentation_model import indentation_model, starting_depth
from limbcli.stages.mesh import read_limb, site_position
from limbcli.units import mpa_from_kpa

STAGE = "diagnose"
F_KAPPA = 100.0
_MATTERS = 0.3  # deviations: what an intervention may move before the model must be mended
_N_DEPTHS = 7
_BEYOND = 1.12
_USUAL_C = 0.006


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


@dataclass(frozen=True, eq=False)
class Intervention:
    """A numerical effect tried: ln of the force's change at the levels, and its largest in deviations."""

    name: str
    log_force: Array
    log_speed: Array
    deviations: float
    note: str = ""
    facts: dict[str, Any] = field(default_factory=dict)


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
            correction = self._correction(book)
            interventions = self._interventions(book) if self.options.interventions else []
            site = self._data(interventions)
            bench = SiteBench(site, book, self.effects, correction=correction, progress=self.progress)
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
        depths = np.linspace(deepest / _N_DEPTHS, deepest, _N_DEPTHS)
        try:
            c, source = tissue_stiffness(self.levels, self.site)
        except LimbError:
            c, source = _USUAL_C, "a usual value (level 0 has no shear-wave speed)"
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

    def _correction(self, book: CurveBook) -> tuple[Array, Array] | None:
        """ln (site's own mesh / working mesh) of the force, from the finished `run` (f_kappa 100, m 2)."""
        try:
            curve = self._own_run()
        except LimbError as error:
            self.writer.warnings.append(f"the working mesh is not tied to the site's own: {error.what}")
            return None
        if curve is None:
            return None
        depth, force = curve
        working = book.curves(2.0)
        inside = (working.depth > 0) & (working.depth <= depth[-1])
        at = PchipInterpolator(np.r_[0.0, depth], np.r_[0.0, force])(working.depth)
        ratio = np.zeros(len(working.depth))
        ratio[inside] = np.log(np.maximum(at[inside], 1e-9) / working.force[inside])
        ratio[working.depth > depth[-1]] = ratio[inside][-1] if inside.any() else 0.0
        self.writer.data["working_mesh_force_ratio"] = np.exp(ratio[1:])
        return ratio, np.zeros_like(working.log_speed)

    def _own_run(self) -> tuple[Array, Array] | None:
        element, depth, force = self._start_run()
        if element != "tet10":
            self.writer.warnings.append(
                f"the site's own run has {element} elements and is not used to tie the working mesh to it"
            )
            return None
        return depth, force

    def _start_run(self) -> tuple[str, Array, Array]:
        """Element, depths and forces of the site's own run at the start values, scaled to the reference c.

        Raises
        ------
        CaseError
            If there is none, or it was made with other start values.
        """
        ran = read_result(self.out, "run", site=self.site.name)
        built = read_result(self.out, "build-feb", site=self.site.name)
        if built.data.get("f_kappa") != F_KAPPA or built.data.get("m") != 2.0:
            raise CaseError(
                "the site's own run was made with other start values than f_kappa 100, m 2",
                where=str(ran.folder), fix="run `limbcli build-feb` and `limbcli run` without options",
            )  # fmt: skip
        table = np.loadtxt(ran.path("force_depth"), delimiter=",", skiprows=1, ndmin=2)
        depth, force = table[:, 1], table[:, 2]
        rising = np.flatnonzero((np.diff(depth, prepend=0.0) > 1e-6) & (force > 0))
        scale = _reference_c(self.levels, self.site) / mpa_from_kpa(float(built.data["c_kpa"]))
        return str(built.data.get("element")), depth[rising], force[rising] * scale

    # ------------------------------------------------------------ numerical effects

    def _interventions(self, book: CurveBook) -> list[Intervention]:
        found = []
        for name in ("crop", "contact"):
            self.progress.event("note", text=f"numerical check: {name}")
            try:
                found.append(self._intervene(book, effect(name)))
            except LimbError as error:
                self.writer.data.setdefault("numerical_not_evaluated", {})[name] = error.what
        if self.case.model.element == "tet4":
            found += self._locking(book)
        return found

    def _intervene(self, book: CurveBook, numerical: Effect) -> Intervention:
        plain_curves = book.curves(2.0)
        changed = book.curves(2.0, ((numerical, numerical.start),))
        return self._judged(numerical.name, plain_curves, changed, numerical.sentence)

    def _locking(self, book: CurveBook) -> list[Intervention]:
        """The case asks for linear elements: what the site's own tet4 run gives against the working tet10."""
        try:
            element, depth, force = self._start_run()
        except LimbError as error:
            self.writer.data.setdefault("numerical_not_evaluated", {})["locking"] = error.what
            return []
        if element != "tet4":
            return []
        working = book.curves(2.0)
        own = PchipInterpolator(np.r_[0.0, depth], np.r_[0.0, force], extrapolate=True)
        at = own(working.depth)
        linear = replace(working, force=np.maximum(at, 1e-9))
        judged = self._judged("locking", linear, working, "tet4 against tet10")
        if judged.deviations > _MATTERS:
            self.writer.warnings.append(
                f"linear elements lock here: the force changes by up to {judged.deviations:.1f} deviations "
                "with "
                "quadratic ones. That is numerical, not tissue; the diagnosis goes on with tet10."
            )
        return [judged]

    def _judged(self, name: str, before: Curves, after: Curves, note: str) -> Intervention:
        change = np.zeros(len(before.depth))
        change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
        change[0] = change[1]
        at_levels = np.interp(self.levels.depth, before.depth, change)
        speed = np.nan_to_num(after.log_speed - before.log_speed)
        speeds = np.array([np.interp(self.levels.depth, before.depth, column) for column in speed.T]).T
        noise = self.site.noise
        apart = np.maximum.accumulate(self.levels.depth) + 1e-6 * np.arange(len(self.levels))
        slope = np.gradient(self.levels.force, apart)
        deviation = np.hypot(noise.force, np.nan_to_num(slope, posinf=0, neginf=0) * noise.depth)
        size = float(np.max(np.abs(at_levels * self.levels.force) / deviation))
        return Intervention(name, at_levels, speeds, size, note)

    def _data(self, interventions: list[Intervention]) -> SiteData:
        maps = None
        if self.site.swe_maps is not None:
            maps = read_maps(self.site.swe_maps, len(self.levels))
            self.writer.used("swe maps", self.site.swe_maps)
        # With the cut free the force is too low, fixed it is too high: half the difference is the doubt.
        # Twice the penalty halves the gap: the whole of it is twice the difference.
        share = {"crop": 0.5, "contact": 2.0}
        errors = [
            (f"model: {each.name}", share[each.name] * each.log_force, share[each.name] * each.log_speed)
            for each in interventions if each.name in share
        ]  # fmt: skip
        return site_data(
            self.site.name, self.levels, self.site.noise, windows=self.windows, maps=maps, model_error=errors
        )

    # ------------------------------------------------------------ what is left

    def _leave(
        self, found: Diagnosis, site: SiteData, bench: SiteBench, interventions: list[Intervention]
    ) -> None:
        writer = self.writer
        content = diagnosis_json(found, site, bench.effects)
        content["numerical"] = [
            {"name": i.name, "note": i.note, "largest_change_in_deviations": i.deviations,
             "matters": i.deviations > _MATTERS, "log_force_change": i.log_force}
            for i in interventions
        ]  # fmt: skip
        content["f_kappa_held_at"] = F_KAPPA
        lines = sentences(found)
        moved = [i.name for i in interventions if i.deviations > _MATTERS]
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


def _reference_c(levels: Levels, site: Site) -> float:
    try:
        return tissue_stiffness(levels, site)[0]
    except LimbError:
        return _USUAL_C
