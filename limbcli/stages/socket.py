"""socket: put the limb into its socket, load it, and report pressure and shear on the skin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.case.reading import CaseReading
from limbcli.case.socket import SocketInput, read_socket
from limbcli.errors import CaseError, SolveError
from limbcli.errors.problems import raise_errors
from limbcli.feb.write import write_feb
from limbcli.meshing.export import write_vtu
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import kpa_from_mpa
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import note_templates, noted
from limbcli.provenance.requested_options import requested_of
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.sockets.alignment import misplaced
from limbcli.sockets.donning import DonningOptions, DonningResult, SocketState, don_and_load, for_febio
from limbcli.stages.in_socket.intervals import Pose, drawn_values, pressure_intervals
from limbcli.stages.in_socket.limb_in_socket import LimbInSocket, put_together
from limbcli.stages.in_socket.patch_table import (
    WHOLE,
    Interval,
    PatchPressure,
    patch_masks,
    patch_rows,
    pressure_picture,
    write_patches,
)

STAGE = "socket"
_MARGIN_MM = 10.0  # the contact sees the socket this much farther than the deepest interference
_LEAST_RADIUS_MM = 30.0
_MOST_OFF = 0.1  # error of the held-out solve above which the intervals are called rough
_SOFT_MM, _SOFT = 0.5, 0.2  # penetration that is reported: mm, and of the deepest interference
_NOT_FOR_FEBIO = (
    "socket.feb: under load FEBio 4.11 found no equilibrium of friction with augmented contact; without "
    "--penetration-mm the file is one that it solves"
)
_BALANCE = 1e-4  # of what the socket presses: a larger remainder is an error


Intervals = dict[tuple[float, str, str], Interval]  # by load, patch and quantity


@dataclass(frozen=True)
class SocketOptions:
    """align : place the socket by its shape, as `align` in the case
    donning_steps, load_steps : load steps of donning, and of each load
    contact_penalty : of the contact, as a multiple of the tissue's stiffness at rest
    penetration_mm : how far the skin may lie behind the wall after each load step; 0: what the penalty allows
    intervals : solve again with other values, for intervals over the limb's draws
    """

    align: bool = False
    donning_steps: int = DonningOptions.donning_steps
    load_steps: int = DonningOptions.load_steps
    contact_penalty: float = DonningOptions.penalty
    penetration_mm: float = 0.0
    intervals: bool = True


def socket(
    case: Case,
    *,
    out: Path,
    options: SocketOptions = SocketOptions(),
    templates: Path | None = None,
    progress: Progress = SILENT,
) -> StageResult:
    """Don the socket of a case and load the limb along its axis.

    templates : folder of templates of the .feb; None: the bundled ones

    Raises as `limbcli.socket`.
    """
    progress.event("stage", name=STAGE)
    _given(case, options)
    chain = Chain(case, out)
    limb = chain.result("limb")
    with open_stage(out, STAGE, subject=case.subject) as writer:
        asked = {**vars(options), "templates": templates}
        writer.data["asked"] = requested_of(asked, vars(SocketOptions()))
        note_templates(writer, templates)
        given = _given(noted(case, writer), options)
        writer.used_result(limb, files=[each for each in ("model", "draws") if each in limb.files])
        together = put_together(load_model(limb.path("model")), given, writer)
        donning = donning_options(given, options, together)
        _report_fit(writer, together, given)
        result = don_and_load(
            together.limb, together.face, donning, keep=out / f".work-{STAGE}", progress=progress
        )
        masks = patch_masks(together.limb)
        rows = patch_rows(result.states, masks, together.skin.areas)
        _report(writer, result, rows, together)
        _report_balance(writer, result)
        intervals: Intervals = {}
        if options.intervals and "draws" in limb.files:
            drawn = drawn_values(
                limb.path("draws"), given.friction, given.friction_deviation,
                tilt_deg=given.tilt_deviation, shift_mm=given.shift_deviation,
            )  # fmt: skip
            intervals = _intervals(together, donning, drawn, rows, writer, progress)
        elif options.intervals:
            writer.summary.append("no intervals: the limb has no draws, because no site tells its stiffness")
        write_patches(writer.file("patches", "patches.csv"), rows, intervals)
        for state in result.states:
            name = _name(state)
            pressure_picture(
                writer.file(f"picture_{name}", f"pressure_{name}.png"),
                together,
                kpa_from_mpa(state.facet_pressure_mpa),
                f"{case.subject}: pressure on the {together.pressed}, {_words(state)}",
            )
        _write_skin(writer.file("skin", "skin_pressure.npz"), result, together)
        write_feb(for_febio(result.model), writer.file("feb", "socket.feb"), templates)
        writer.summary.extend(for_febio_to_solve(result.model))
        _write_vtu(writer.file("vtu", "socket.vtu"), result, together)
        writer.warnings.extend(limb.warnings)
    return writer.result


def _given(case: Case, options: SocketOptions) -> SocketInput:
    reading = CaseReading.of(case.raw, case.folder)
    given = read_socket(case.raw, reading)
    raise_errors(reading.problems, CaseError)
    if given is None:
        raise CaseError(
            "the case gives no socket",
            where=str(case.file),
            fix='add a table [socket] with `surface = "socket.stl"`, or with rectifications of the skin',
        )
    if options.align and given.surface is None:
        raise CaseError("a socket made from the skin needs no alignment", where="--align", fix="leave it out")
    if options.align and given.landmarks:
        what = "the case gives landmarks: with --align there are two ways to place the socket"
        raise CaseError(what, where="--align", fix="leave it out, or remove [socket.landmarks]")
    return replace(given, align=given.align or options.align)


def donning_options(given: SocketInput, options: SocketOptions, together: LimbInSocket) -> DonningOptions:
    return DonningOptions(
        friction=given.friction,
        loads_n=given.loads,
        axis="z",
        sign=1.0,
        donning_steps=options.donning_steps,
        load_steps=options.load_steps,
        penalty=options.contact_penalty,
        penetration_mm=options.penetration_mm or None,
        skin=together.touching,
        liner_slides=together.slides,
        liner_friction=None if given.liner is None else given.liner.friction,
        knee=together.knee,
        search_radius_mm=max(_LEAST_RADIUS_MM, together.fit.deepest_mm + _MARGIN_MM),
    )


def _intervals(
    together: LimbInSocket, donning: DonningOptions, drawn: Array, rows: list[PatchPressure],
    writer: StageWriter, progress: Progress,
) -> Intervals:  # fmt: skip
    """Intervals over the limb's draws (`drawn_values`); their error and shares in the result."""
    masks = patch_masks(together.limb)

    def solved(model: LimbModel, friction: float, pose: Pose) -> list[PatchPressure]:
        changed = replace(donning, friction=friction)
        face = misplaced(together.face, pose[:2], pose[2:])
        states = don_and_load(model, face, changed, progress=progress).states
        return patch_rows(states, masks, together.skin.areas)

    try:
        found = pressure_intervals(together.limb, donning.friction, rows, drawn, solved, progress)
    except SolveError as error:
        writer.warnings.append(f"{error.what}; {error.fix}")
        return {}
    writer.data["intervals"] = {
        "n_solves": found.n_solves,
        "held_out_error_fraction": found.error_fraction,
        "deviations": found.deviations,
        "shares": {f"{load:g}": each for load, each in found.shares.items()},
        "patches": [
            {"load_n": load, "patch": patch, "quantity": name, "low": low, "high": high}
            for (load, patch, name), (low, high) in found.intervals.items()
        ],
    }
    load, shares = list(found.shares.items())[-1]
    low, high = found.intervals[load, WHOLE, "mean_kpa"]
    words = ", ".join(f"{name} {100 * each:.0f} %" for name, each in shares.items())
    writer.summary.append(
        f"mean pressure under {load:g} N: {low:.1f} to {high:.1f} kPa (95 %) over the limb's draws; of its "
        f"variance: {words}; a held-out solve is off by {100 * found.error_fraction:.1f} %"
    )
    if found.one_sided:
        places = ", ".join(each.replace("_", " ") for each in found.one_sided)
        writer.warnings.append(
            f"the intervals take the pressures as linear in the socket's {places}, from one side: the other "
            "has no equilibrium; more load steps may find it (--load-steps)"
        )
    if found.rough:
        load, patch, off_kpa = max(found.rough, key=lambda each: each[2])
        writer.warnings.append(
            f"intervals of {len(found.rough)} mean pressures are rough, most that of "
            f"{patch.replace('_', ' ')} under {load:g} N: the held-out solve is {off_kpa:.1f} kPa off there"
        )
    if found.error_fraction > _MOST_OFF:
        writer.warnings.append("the intervals are rough: the pressures are not linear over the draws")
    return found.intervals


def _report_fit(writer: StageWriter, together: LimbInSocket, given: SocketInput) -> None:
    fit = together.fit
    writer.data.update(
        socket=together.words, pressed=together.pressed, friction=given.friction, loads_n=list(given.loads),
        deepest_interference_mm=fit.deepest_mm, widest_gap_mm=fit.widest_mm, frame=together.frame.to_json(),
    )  # fmt: skip
    writer.summary.append(f"socket: {together.words}")
    if together.alignment is not None:
        moved = together.alignment
        writer.summary.append(moved.sentence)
        writer.data["alignment"] = {
            "to_upright_frame": moved.transform, "rms_mm": moved.rms_mm, "largest_mm": moved.largest_mm,
            "turned_deg": moved.turned_deg, "height_uncertainty_mm": moved.height_mm,
        }  # fmt: skip
    writer.summary.append(
        f"before donning the wall lies up to {fit.deepest_mm:.1f} mm inside the skin and "
        f"{fit.widest_mm:.1f} mm outside"
    )


def _report(
    writer: StageWriter, result: DonningResult, rows: list[PatchPressure], together: LimbInSocket
) -> None:
    """States, balance of forces and patches, in result and summary."""
    writer.data["states"] = [_state(each) for each in result.states]
    writer.data["patches"] = [vars(each) for each in rows]
    writer.data["largest"] = vars([each for each in rows if each.patch == WHOLE][-1])
    for state in result.states:
        words = _words(state)
        (whole,) = (each for each in rows if each.load_n == state.load_n and each.patch == WHOLE)
        if not whole.contact_area_mm2:
            writer.warnings.append(f"{words}: the limb does not touch the socket")
        writer.summary.append(
            f"{words}: mean {whole.mean_kpa:.1f} kPa on {whole.contact_area_mm2 / 100:.0f} cm2, 95 % below "
            f"{whole.p95_kpa:.1f}, peak {whole.peak_kpa:.1f}; shear up to {whole.peak_shear_kpa:.1f} kPa"
        )
        x, y, z = state.socket_force_n
        writer.summary.append(
            f"{words}: forces on the socket {z:+.2f} N along the axis, {np.hypot(x, y):.2f} N across; "
            f"those on bones and cut leave {state.imbalance_n:.2g} N; {together.behind} up to "
            f"{state.penetration_mm:.2f} mm behind the wall"
        )
        if state.load_n:
            shift = float(state.socket_shift_mm[2])
            where = "down" if shift < 0 else "up"
            writer.summary.append(
                f"{words}: the socket has moved {abs(shift):.1f} mm {where} the limb since donning"
            )
        if state.load_n and together.knee is not None:
            at_knee = state.moment_about(np.asarray(together.knee.centre)) / 1e3
            writer.summary.append(
                f"{words}: about the knee centre the moment on the socket is {_vector(at_knee)} N m (left, "
                f"back, up), the force {_vector(state.socket_force_n)} N"
            )
        if state.penetration_mm > max(_SOFT_MM, _SOFT * together.fit.deepest_mm):
            writer.warnings.append(
                f"{words}: {together.behind} up to {state.penetration_mm:.1f} mm behind the wall, which the "
                "contact allows: pressures are too low there; raise --contact-penalty, or give a (smaller) "
                "--penetration-mm"
            )


def _report_balance(writer: StageWriter, result: DonningResult) -> None:
    """What forces and moments leave over, of all load steps; too much is refused."""
    worst = result.worst
    writer.data["balance"] = [{**vars(each), "share": each.share} for each in result.balance]
    writer.summary.append(
        f"balance over {len(result.balance)} load steps: forces and moments leave at most {worst.share:.1g} "
        f"of what the socket presses ({worst.aim})"
    )
    if worst.share > _BALANCE:
        raise SolveError(
            f"{worst.aim}: {worst.left_n:.3g} N and {worst.left_n_mm:.3g} N mm are left of the "
            f"{worst.contact_n:.4g} N with which the socket presses",
            where="balance of forces and moments", fix="use more donning and load steps",
            imbalance_n=worst.left_n,
        )  # fmt: skip


def for_febio_to_solve(model: LimbModel) -> list[str]:
    """What to change so that FEBio solves the file, if it does not."""
    return [_NOT_FOR_FEBIO] if model.has_friction and any(each.augmented for each in model.contacts) else []


def _words(state: SocketState) -> str:
    return f"under {state.load_n:g} N" if state.load_n else "donned"


def _vector(values: Array) -> str:
    return ", ".join(f"{each + 0.0:+.1f}" for each in values)


def _name(state: SocketState) -> str:
    """
    >>> from types import SimpleNamespace as State
    >>> _name(State(load_n=0.0)), _name(State(load_n=400.0))
    ('donned', 'load_400_n')
    """
    return f"load_{state.load_n:g}_n" if state.load_n else "donned"


def _state(state: SocketState) -> dict[str, object]:
    return {
        "name": _name(state), "load_n": state.load_n, "force_on_socket_n": state.socket_force_n,
        "moment_on_socket_n_mm": state.socket_moment_n_mm, "socket_shift_mm": state.socket_shift_mm,
        "imbalance_n": state.imbalance_n, "penetration_mm": state.penetration_mm,
        "largest_strain": float(state.strain.max()),
        "largest_energy_density_kpa": kpa_from_mpa(float(state.energy_density.max())),
        "largest_displacement_mm": float(np.linalg.norm(state.displacements, axis=1).max()),
    }  # fmt: skip


def _write_skin(path: Path, result: DonningResult, together: LimbInSocket) -> None:
    """For the page's 3-D view: corners of what bears the pressures, upright, mm, under the last load."""
    state = result.states[-1]
    facets = next(iter(result.model.mesh.surfaces[together.pressed].facets.values()))[:, :3]
    used, triangles = np.unique(facets, return_inverse=True)
    np.savez_compressed(
        path,
        points=result.model.mesh.points[used],
        displacement=state.displacements[used],
        triangles=triangles.reshape(-1, 3),
        pressure_kpa=kpa_from_mpa(state.pressure_mpa[np.searchsorted(result.skin_nodes, used)]),
    )


def _write_vtu(path: Path, result: DonningResult, together: LimbInSocket) -> None:
    """Limb and socket in patient LPS; by state: displacement, pressure, shear, strain, energy density."""
    mesh = result.model.mesh
    at_points: dict[str, Array] = {}
    cells: dict[str, dict[str, Array]] = {each.name: {} for each in mesh.solid_blocks}
    for state in result.states:
        name = _name(state)
        at_points[f"displacement_mm_{name}"] = together.directions_in_lps(state.displacements)
        for what, values in (("pressure", state.pressure_mpa), ("shear", state.shear_mpa)):
            column = np.full(len(mesh.points), np.nan)
            column[result.skin_nodes] = kpa_from_mpa(values)
            at_points[f"{what}_kpa_{name}"] = column
        start = 0
        for block in mesh.solid_blocks:
            own = slice(start, start := start + len(block.cells))
            cells[block.name][f"strain_{name}"] = state.strain[own]
            cells[block.name][f"energy_density_kpa_{name}"] = kpa_from_mpa(state.energy_density[own])
    placed = replace(mesh, points=together.in_lps(mesh.points))
    write_vtu(placed, path, values=cells, at_points=at_points)
