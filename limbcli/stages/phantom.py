"""`limbcli phantom DIR`: a synthetic subject with known true parameters, as a complete case folder.

    DIR/case.toml, mri/, p1/{levels.csv, trace.csv, swe/}, ...    the files that a user would provide
    DIR/truth/{truth.toml, labels.nii.gz, skin.ply, bone_*.ply}   the truth, which no stage reads

The force-depth curves are simulated on the true surfaces, on a mesh other than the fitted one
(see `stages.synth`), with noise added. The same seed gives the same folder.

`cases/phantom` also contains an `expected.toml` for `limbcli batch --expect`, in
the format of `stages.expect`: a table [site.p1] with `m = {value = 6.0, tolerance = 1.5}`,
`r2 = {min = 0.98}` and so on. It is kept when the folder is made again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.case.schema import plain_name
from limbcli.errors import CaseError
from limbcli.errors.pasted_commands import typed
from limbcli.files.atomic import atomic_folder
from limbcli.files.temporary_folders import scratch_folder
from limbcli.imaging.surface import write_surface
from limbcli.phantom import truth
from limbcli.phantom.case_folder import LEVELS_HEADER, NoiseLaw, case_table, geometry_truth, site_table, toml
from limbcli.phantom.dicom_series import write_series
from limbcli.phantom.mri import SimulatedVolume, acquire, tissue_fractions
from limbcli.phantom.simulated_readings import write_readings
from limbcli.phantom.subject import PLACES, PhantomSite, Subject, make_subject
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, provenance
from limbcli.stages.expect import keep_expected
from limbcli.stages.machine.kernels import compile_ahead
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.simulated_subjects.synth_truth import SyntheticSite, summary_of, truth_table
from limbcli.stages.synth import measure_sites

TRUTH = "truth"
LABELS = "labels.nii.gz"
USUAL_SITES = ("p1",)


@dataclass(frozen=True)
class PhantomOptions:
    """Options of the synthetic subject.

    voxel : mm; site_names : some of `subject.PLACES` (a single one keeps a trial short)
    element : the element type in case.toml; synth : how to simulate and measure, None for a case
        without measurements (its seed is replaced by this one's); noise : the noise in case.toml, before
        the factor in `synth`
    """

    seed: int = 7
    subject_id: str = "phantom"
    voxel: tuple[float, float, float] = (1.0, 1.0, 4.0)
    site_names: tuple[str, ...] = USUAL_SITES
    element: str = "tet10"
    noise: NoiseLaw = field(default_factory=NoiseLaw)
    synth: SynthOptions | None = field(default_factory=SynthOptions)


def refuse_unheard(plan: SynthOptions) -> None:
    """Refuse options of tissue and measurement for a case without measurements.

    Raises CaseError if any option of `plan` except the element (which case.toml also states) is not the
    default.
    """
    usual = SynthOptions()
    if replace(plan, seed=usual.seed, element=None) != usual:
        raise CaseError(
            "tissue, measurement or mesh options are given, but nothing is to be measured",
            where="--no-measurement",
            fix="omit --no-measurement, or the others: `limbcli synth` accepts them later, on that case",
        )


def phantom(
    folder: Path,
    *,
    options: PhantomOptions = PhantomOptions(),
    force: bool = False,
    progress: Progress = SILENT,
) -> StageResult:
    """Make the case folder, completely or not at all. Raises as `limbcli.make_phantom`."""
    if (wrong := plain_name(options.subject_id)) is not None:
        raise CaseError(f"the subject's id {wrong}", where="--id", fix="give a short name, such as S1")
    _check_target(folder, force=force)
    places = _places(options.site_names)
    rng_shape, rng_image = (np.random.default_rng([options.seed, k]) for k in (1, 2))
    subject = make_subject(rng_shape, voxel=options.voxel, places=places)
    progress.event("stage", name="phantom", site=None)
    if options.synth is not None:
        compile_ahead()
    with atomic_folder(folder, is_new=not force) as work:
        fractions = tissue_fractions(
            subject.anatomy, subject.grid, subject.limb_from_patient, progress=progress
        )
        volume = acquire(fractions, subject.grid, rng=rng_image)
        write_series(work / "mri", volume.signal, subject.grid, subject=options.subject_id, seed=options.seed)
        _write_geometry(subject, volume, work)
        _write_case(subject, work, options, options.noise, measured=False)
        measured = _measure(subject, work, options, progress)
        if measured:
            _write_case(subject, work, options, measured[0].law, measured=True)
        table = geometry_truth(subject, seed=options.seed, dice_labels=LABELS)
        if measured and options.synth is not None:
            table |= truth_table(measured, options.synth)
        (work / TRUTH / "truth.toml").write_text(toml(table), encoding="utf-8")
        keep_expected(folder, work)
        _check_target(folder, force=force)  # another program may have made it meanwhile
    return _result(folder, subject, volume, measured, options)


def _check_target(folder: Path, *, force: bool) -> None:
    if not folder.exists():
        return
    if not force:
        fix = "add --force to replace it, or give another folder"
        raise CaseError(f"{folder} is there already", where=str(folder), fix=fix)
    if folder.is_dir() and (not any(folder.iterdir()) or (folder / TRUTH / "truth.toml").is_file()):
        return
    what = (
        f"{folder} is not a synthetic subject (it contains no {TRUTH}/truth.toml); --force does not "
        f"replace it"
    )
    raise CaseError(what, where=str(folder), fix="name another folder")


def _places(names: tuple[str, ...]) -> tuple[PhantomSite, ...]:
    known = {each.name: each for each in PLACES}
    for name in names:
        if name not in known:
            fix = f"choose from {', '.join(known)}"
            raise CaseError(f"the phantom has no site {name!r}", where="--site", fix=fix)
    return tuple(each for each in PLACES if each.name in names)


def _write_geometry(subject: Subject, volume: SimulatedVolume, work: Path) -> None:
    """Write the true label map and surfaces."""
    folder = work / TRUTH
    folder.mkdir()
    truth.write_labels(folder / LABELS, volume.labels, subject.grid)
    for name, surface in truth.surfaces(subject).items():
        write_surface(folder / f"{name}.ply", surface)


def _measure(
    subject: Subject, work: Path, options: PhantomOptions, progress: Progress
) -> list[SyntheticSite]:
    """Simulate and write the readings; on the truth surfaces, or on the case's own mesh."""
    if options.synth is None:
        return []
    plan = replace(options.synth, seed=options.seed)
    with scratch_folder() as scratch:
        source = work if plan.same_mesh else _truth_case(subject, work, scratch / "case", options)
        case = Case.open(source)
        measured = measure_sites(case, case.sites, out=scratch / "out", options=plan, progress=progress)
    for each in measured:
        write_readings(work / each.site, each.readings)
    return measured


def _truth_case(subject: Subject, work: Path, folder: Path, options: PhantomOptions) -> Path:
    """A case without images: the true surfaces, every site at its true position."""
    surfaces = {path.stem: str(path.resolve()) for path in (work / TRUTH).glob("*.ply")}
    bones = sorted(path for name, path in surfaces.items() if name.startswith("bone"))
    sites = []
    for place in subject.places:
        table = site_table(place, subject, marker=None, noise=options.noise, measured=False)
        sites.append({**table, "levels": str((work / table["levels"]).resolve())})
    folder.mkdir()
    table = case_table(
        subject_id=options.subject_id,
        imaging={"skin": surfaces["skin"], "bones": bones},
        sites=sites,
        element=options.element,
    )
    mine = {"files": {"allow_outside": True}}  # the surfaces lie in the subject that is being made
    (folder / "case.toml").write_text(toml({**table, **mine}), encoding="utf-8")
    return folder


def _write_case(
    subject: Subject, work: Path, options: PhantomOptions, law: NoiseLaw, *, measured: bool
) -> None:
    """Write case.toml; without measurements every levels.csv consists of its header only."""
    sites = []
    for place in subject.places:
        marker = 1 if place.by_marker else None  # markers are numbered from distal to proximal
        sites.append(site_table(place, subject, marker=marker, noise=law, measured=measured))
        if not measured:
            (work / place.name).mkdir()
            (work / place.name / "levels.csv").write_text(LEVELS_HEADER, encoding="utf-8")
    table = case_table(
        subject_id=options.subject_id, imaging={"mri": "mri"}, sites=sites, element=options.element
    )
    (work / "case.toml").write_text(toml(table), encoding="utf-8")


def _result(
    folder: Path,
    subject: Subject,
    volume: SimulatedVolume,
    measured: list[SyntheticSite],
    options: PhantomOptions,
) -> StageResult:
    size = sum(each.stat().st_size for each in folder.rglob("*") if each.is_file())
    labels = volume.labels
    data: dict[str, Any] = {
        "seed": options.seed,
        "image_shape": list(subject.grid.shape),
        "voxel_mm": subject.grid.spacing,
        "volume_ml": {
            "limb": float((labels > 0).sum() * subject.grid.spacing.prod() / 1e3),
            "bone": float((labels == 2).sum() * subject.grid.spacing.prod() / 1e3),
        },
        "sites": [each.name for each in subject.places],
        "tissue": vars(options.synth.tissue) if options.synth else None,
        "n_levels": {each.site: len(each.readings.force) for each in measured},
        "size_bytes": size,
    }
    summary = [
        f"{subject.grid.shape[2]} slices of {subject.grid.shape[0]} x {subject.grid.shape[1]}"
        f" voxels, {size / 1e6:.1f} MB in all; sites {', '.join(data['sites'])}",
        *map(summary_of, measured),
        f"next: limbcli {'batch' if measured else 'segment'} {typed(folder)}",
    ]
    return StageResult(
        stage="phantom",
        subject=options.subject_id,
        folder=folder,
        files={"case": "case.toml", "truth": f"{TRUTH}/truth.toml"},
        data=data,
        summary=tuple(summary),
        provenance=provenance(),
    )
