"""`limbcli synth CASE`: simulated measurements with known parameters, on the geometry of an existing case.

A new case folder is written with the original's images and the simulated measurements; the true
values are written next to it, in a file that no stage reads. The simulation uses a different mesh
from the fit unless `same_mesh` is set. A site with states is measured in each of them, its tissue
stretched before the probe touches it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.case import CASE_FILE, Case, Site
from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file, atomic_folder
from limbcli.files.temporary_folders import scratch_folder
from limbcli.model import LimbModel
from limbcli.model.npz_file import load_model
from limbcli.phantom.case_folder import NoiseLaw, toml
from limbcli.phantom.protocol import TrueLevels
from limbcli.phantom.simulated_readings import Readings, measure, write_levels, write_readings
from limbcli.progress import SILENT, Progress
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, provenance, read_result, stage_folder
from limbcli.site_model.indentation_model import with_penalty
from limbcli.site_model.site_layers import MRI, held_layers
from limbcli.stages.expect import keep_expected
from limbcli.stages.simulated_subjects.hidden_effects import (
    check_beside_layers,
    check_beside_numbers,
    in_order,
)
from limbcli.stages.simulated_subjects.indent import Press, indent
from limbcli.stages.simulated_subjects.known_stretches import check_stretches, true_states
from limbcli.stages.simulated_subjects.synth_case import (
    borders_at_rest,
    case_table,
    check_orientations,
    copy_imaging,
)
from limbcli.stages.simulated_subjects.synth_options import Alter, SynthOptions
from limbcli.stages.simulated_subjects.synth_truth import SyntheticSite, summary_of, truth_table

# Relative residual at convergence (norm of the residual over that of the forces): a value far below the noise
# of the readings, and a stricter one for readings without noise.
_TOLERANCE, _FINE_TOLERANCE = 1e-4, 1e-6


def synth(
    case: Case, *, out: Path, out_case: Path, sites: list[str] | None = None,
    options: SynthOptions = SynthOptions(), force: bool = False, progress: Progress = SILENT,
) -> StageResult:  # fmt: skip
    """Write a copy of `case` with simulated measurements, and the true values to `truth_file(out_case)`.

    Raises as `limbcli.synth`.
    """
    _check_target(case, out_case, force=force)
    chosen = case.selected(sites)
    check_stretches(case, chosen, options.stretches)
    check_orientations(chosen)
    measured = measure_sites(case, chosen, out=out, options=options, progress=progress)
    with atomic_file(truth_file(out_case)) as path:  # written before the case is replaced, put in place after
        path.write_text(toml(truth_table(measured, options)), encoding="utf-8")
        with atomic_folder(out_case) as work:
            copy_imaging(case, work)
            for each in measured:
                write = write_readings if each.state is None else write_levels
                write(work / each.label, each.readings)
            table = case_table(case, {each.site: each.law for each in measured}, layers=options.layers)
            (work / CASE_FILE).write_text(toml(table), encoding="utf-8")
            keep_expected(out_case, work)
            _check_target(case, out_case, force=force)  # another program may have made it meanwhile
            if (before := truth_file(out_case)).exists():
                os.truncate(before, 0)  # if killed from here on, an empty truth file rather than a wrong one
    return StageResult(
        stage="synth",
        subject=case.subject,
        folder=out_case,
        files={"case": CASE_FILE},
        data={
            "truth": str(truth_file(out_case)),
            "sites": list(dict.fromkeys(each.site for each in measured)),
            "n_levels": {each.label: len(each.readings.force) for each in measured},
        },
        summary=(*map(summary_of, measured), f"truth: {truth_file(out_case)}"),
        provenance=provenance(),
    )


def truth_file(out_case: Path) -> Path:
    """Path of the file with the true values of a simulated case: next to its folder, not in it.

    >>> truth_file(Path("data/calf-synth")).as_posix()
    'data/calf-synth.truth.toml'
    """
    return out_case.parent / f"{out_case.name}.truth.toml"


def _check_target(case: Case, out_case: Path, *, force: bool) -> None:
    where = str(out_case)
    if out_case.resolve() == case.folder.resolve():
        raise CaseError("--out-case is the case itself", where=where, fix="name another folder")
    if not out_case.exists() or (out_case.is_dir() and not any(out_case.iterdir())):
        return
    if not force:
        fix = "add --force to replace it, or give another folder"
        raise CaseError(f"{out_case} is there already", where=where, fix=fix)
    if not truth_file(out_case).is_file():
        what = f"{out_case} was not made by synth ({truth_file(out_case).name} was not found next to it)"
        raise CaseError(what, where=where, fix="--force replaces only what synth made; give another folder")


# ---------------------------------------------------------------- simulation and reading


def measure_sites(
    case: Case, sites: tuple[Site, ...], *, out: Path, options: SynthOptions, progress: Progress = SILENT
) -> list[SyntheticSite]:
    """Simulate every site on its mesh and take the readings; run `segment` and `mesh` if necessary.

    Raises CaseError if the fitted mesh is to be used, but another element type or other sizes are given.
    """
    # these have no effect when the fitted mesh is used
    usual, names = SynthOptions(), ("size", "far_size", "margin")
    if options.same_mesh and any(getattr(options, each) != getattr(usual, each) for each in names):
        raise CaseError(
            "mesh sizes are given, but no mesh is made",
            where="--same-mesh",
            fix="omit --size-mm, --far-size-mm and --margin-mm, or omit --same-mesh; `limbcli "
            "mesh` sets those of the mesh that is fitted",
        )
    if case.imaging.shape is not None:
        check_beside_numbers(options.hidden)
    numbers = {each.name: k for k, each in enumerate(case.sites)}
    with scratch_folder() as scratch:
        _segmented(case, out, progress)
        folder = out if options.same_mesh else scratch
        if not options.same_mesh:
            shutil.copytree(stage_folder(out, "segment"), stage_folder(folder, "segment"))
        return [
            each
            for site in sites
            for each in _measure_site(case, site, folder, options, numbers[site.name], progress)
        ]


def _segmented(case: Case, out: Path, progress: Progress) -> None:
    from limbcli.stages.segment import segment

    seen = [each.name for each in case.sites if MRI in (t.get("thickness_mm") for t in each.layers.values())]
    if Chain(case, out).present("segment", about=seen) is None:
        segment(case, out=out, progress=progress)


def _meshed(case: Case, site: Site, folder: Path, options: SynthOptions, progress: Progress) -> LimbModel:
    from limbcli.stages.mesh import MeshRequest, mesh

    place = stage_folder(folder, "mesh", site.name)
    there = Chain(case, folder).present("mesh", site=site.name)
    if there is not None and options.element not in (None, there.data.get("element")):
        raise CaseError(
            f"the mesh that is fitted is of {there.data.get('element')}, not of {options.element}",
            where=f"site {site.name}",
            fix="omit --element or --same-mesh",
        )
    if there is None:
        request = MeshRequest(element=options.element)
        if not options.same_mesh:
            request = replace(request, size=options.size, far_size=options.far_size, margin=options.margin)
        mesh(case, out=folder, sites=[site.name], options=request, progress=progress)
    return load_model(place / "model.npz")


def _measure_site(
    case: Case, site: Site, folder: Path, options: SynthOptions, number: int, progress: Progress
) -> list[SyntheticSite]:
    """Simulate one measurement of a site, or one in each of its states."""
    progress.event("stage", name="synth", site=site.name)
    if site.states and options.layers:
        raise CaseError(
            f"layers are not read in the states of site {site.name}",
            where="--with-layers",
            fix="omit it, or use a case without [[site.state]]",
        )
    borders = borders_at_rest(read_result(folder, "segment"), site) if options.layers else None
    model = _meshed(case, site, folder, options, progress)
    if options.alter is not None:
        model = options.alter(model)
    penalty = options.contact_penalty
    contact = None if penalty is None else partial(with_penalty, penalty=penalty)
    hidden = in_order(options.hidden)
    check_beside_layers(hidden, held_layers(model))
    for_waves = [contact, *(each.for_waves or each.in_model for each in hidden)]
    protocol = replace(options.protocol, first=sum(each.preload for each in hidden))
    noise = site.noise
    law = NoiseLaw(noise.force, noise.depth, noise.swe_level_fraction, noise.swe_pixel_fraction, noise.layer)
    law = law.times(options.noise)
    block = model.mesh.solid_blocks[0]
    facts = {"element": block.kind, "n_elements": len(block.cells), "same_mesh": options.same_mesh}
    found = []
    for k, state in enumerate(true_states(site, options.stretches) or [None]):
        if state is not None:
            progress.event("note", text=f"state {state.name}")
        press = Press(
            meshed=model, tissue=options.tissue, progress=progress,
            tolerance=_FINE_TOLERANCE if options.noise == 0 else _TOLERANCE,
            change=_change([contact, *(each.in_model for each in hidden)]),
            stretch=None if state is None else (state.along, state.around),
        )  # fmt: skip
        true = indent(
            press, protocol=protocol, density_kg_per_m3=site.density_kg_per_m3,
            change_for_waves=_change(for_waves), borders=borders,
        )  # fmt: skip
        readings = read_off(true, law, options, number, state=None if state is None else k)
        found.append(
            SyntheticSite(site=site.name, true=true, readings=readings, law=law, facts=facts, state=state)
        )
    return found


def read_off(
    true: TrueLevels, law: NoiseLaw, options: SynthOptions, number: int, *, state: int | None = None
) -> Readings:
    """Simulated readings of the true levels at the case's site `number`, with noise by `options.seed`.

    state : number of the state in which it is measured; each state has independent noise
    """
    rng = np.random.default_rng([options.seed, 3, number, *([] if state is None else [state])])
    readings = measure(true, law, protocol=options.protocol, rng=rng)
    for each in in_order(options.hidden):
        if each.in_readings is not None:
            readings = each.in_readings(readings, true)
    return readings


def _change(found: Sequence[Alter | None]) -> Alter | None:
    """The composition of all changes of the loaded model, in order; None if there are none."""
    changes = [each for each in found if each is not None]
    if not changes:
        return None

    def change(model: LimbModel) -> LimbModel:
        for each in changes:
            model = each(model)
        return model

    return change
