"""Outputs of `run` in addition to the solver's own files: force-depth curve, figure, run.json.

In limbcli's models of a site z = 0 is the height of the probe face at first touch. Elsewhere a body may lie
and move anywhere: its depth is its travel since first contact, in the direction in which it moves.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.case.noting import unnoted
from limbcli.drawing import save_figure
from limbcli.feb.outline import Outline
from limbcli.files.plain_text import write_rows
from limbcli.measurement.indentation import Levels
from limbcli.model import Array
from limbcli.results import StageWriter
from limbcli.solvers.febio_versions import reaction_caution, version_caution
from limbcli.solvers.solver import Simulation, Table

COLUMNS = ("time_s", "depth_mm", "force_n")
_NEEDED = {"z", "Fz"}
_PROBE = "probe"
# FEBio's warnings of what limbcli's models want: a probe without mass, a symmetric matrix, must-points, and
# quasi-Newton steps that reform the matrix (see `feb.settings`).
_KNOWN = (
    "Zero mass for rigid body",
    "The sliding-elastic contact algorithm runs better",
    "dtmax is ignored when specifying must points",
    "Max nr of iterations reached",
)
_DIGITS = 12
_TIME_DIGITS = 1e-8  # relative tolerance of times: FEBio writes nine digits


def write_simulation(
    simulation: Simulation,
    outline: Outline,
    writer: StageWriter,
    *,
    levels: Levels | None = None,
    site: Site | None = None,
) -> None:
    """Write the data of run.json, force-depth.csv and force-depth.png."""
    writer.data.update(
        solver=simulation.solver, solver_version=simulation.version, linear_solver=simulation.linear_solver,
        n_steps=int(np.count_nonzero(simulation.times > 0)), n_iterations=simulation.n_iterations,
        n_factorisations=simulation.n_factorisations, solve_seconds=simulation.seconds,
    )  # fmt: skip
    writer.summary.append(
        f"{simulation.solver} {simulation.version}: {writer.data['n_steps']} steps,"
        f" {simulation.n_iterations} iterations, {simulation.n_factorisations} factorisations,"
        f" {simulation.seconds:.1f} s"
    )
    own = outline.has_touch_frame or site is not None
    writer.warnings.extend(log_warnings(simulation, own=own))
    if simulation.solver == "febio":
        logged = [name for table in simulation.nodes.values() for name in table.fields]
        cautions = (version_caution(simulation.version), reaction_caution(simulation.version, logged))
        writer.warnings.extend(filter(None, cautions))
    names = _with_curve(simulation)
    body = _PROBE if _PROBE in names else next(iter(names), None)
    if body is None:
        writer.warnings.append("no rigid body logs z and Fz, so there is no force-depth curve")
        return
    writer.warnings.extend(curve_warnings(simulation, body))
    if own:
        depth, force = simulation.probe_depth(body), simulation.probe_force(body)
    else:
        found = travel(body, simulation.rigid[body])
        depth, force = found.depth, found.force
        (writer.summary if found.touches else writer.warnings).append(found.note)
    curve = np.stack([simulation.times, depth, force], axis=1)[simulation.times > 0]
    rows = ([f"{value:.{_DIGITS}g}" for value in row] for row in curve.tolist())
    write_rows(writer.file("force_depth", "force-depth.csv"), COLUMNS, rows)
    at_levels = at_must_points(curve, outline.must_points).tolist()
    writer.data.update(
        probe=body, max_depth_mm=float(curve[:, 1].max()), max_force_n=float(curve[:, 2].max()),
        levels=[dict(zip(COLUMNS, row, strict=True)) for row in at_levels],
    )  # fmt: skip
    writer.summary.append(f"{curve[-1, 2]:.3f} N at {curve[-1, 1]:.2f} mm")
    draw_curve(
        writer.file("picture", "force-depth.png"), curve, outline.must_points, simulation, levels, site
    )


def curve_warnings(simulation: Simulation, body: str) -> list[str]:
    """A warning if the curve may be another body's."""
    names = _with_curve(simulation)
    if len(names) < 2 or body == _PROBE:
        return []
    return [f"{' and '.join(names)} log z and Fz and none is called {_PROBE}: the curve is that of {body}"]


def log_warnings(simulation: Simulation, *, own: bool) -> list[str]:
    """What the solver's log warns of, each once.

    own : a model of limbcli's, whose settings cause some of FEBio's warnings knowingly
    """
    counts = Counter(simulation.warnings)
    return [
        f"{simulation.solver} warns{f' ({count} times)' if count > 1 else ''}: {text}"
        for text, count in counts.items()
        if not (own and text.startswith(_KNOWN))
    ]


def _with_curve(simulation: Simulation) -> list[str]:
    """The bodies that log height and force."""
    return [name for name, table in simulation.rigid.items() if set(table.fields) >= _NEEDED]


def at_must_points(curve: Array, must_points: tuple[float, ...]) -> Array:
    """The converged steps at must-points, each once: the last of several that agree within the tolerance.

    >>> curve = np.array([[0.142857143, 1.0, 2.0], [0.142857143, 1.1, 2.1], [1234.56789, 3.0, 4.0]])
    >>> at_must_points(curve, (1 / 7, 0.5, 1234.567891))[:, 1]
    array([1.1, 3. ])
    """
    near = np.isclose(curve[:, 0], np.array(must_points).reshape(-1, 1), rtol=_TIME_DIGITS, atol=1e-9)
    found = [int(np.flatnonzero(rows)[-1]) for rows in near if rows.any()]
    return np.asarray(curve[found])


def draw_curve(
    path: Path, curve: Array, must_points: tuple[float, ...], simulation: Simulation, levels: Levels | None,
    site: Site | None,
) -> None:  # fmt: skip
    """Plot simulated force against depth with the levels marked, and the measured points if there are any."""
    from limbcli.reporting.figures.force_depth import MeasuredCurve, SimulatedCurve, force_depth
    from limbcli.reporting.figures.style import new_figure, style

    by = f"({simulation.solver} {simulation.version})"
    if levels is not None:
        noise = unnoted(site).noise if site is not None else None  # of the picture
        depth, force = np.r_[0.0, curve[:, 1]], np.r_[0.0, curve[:, 2]]
        measured = MeasuredCurve(
            depth=levels.depth,
            force=levels.force,
            depth_sd=noise.depth if noise else None,
            force_sd=noise.force if noise else None,
            unloading=~levels.loading,
        )
        simulated = SimulatedCurve("start", f"simulated, start values {by}", depth, force)
        save_figure(force_depth(measured, [simulated]), path)
        return
    with style():
        figure = new_figure()
        axes = figure.add_subplot()
        axes.plot(curve[:, 1], curve[:, 2], "-", color="C0", label=f"simulated {by}")
        marked = at_must_points(curve, must_points)
        axes.plot(marked[:, 1], marked[:, 2], "o", color="C0", markersize=5, label="must-points")
        axes.set(xlabel="probe depth / mm", ylabel="force on the tissue / N")
        axes.legend()
        save_figure(figure, path)


AXES = "xyz"
_NO_FORCE = 1e-9  # force that is round-off, relative to the largest
_LEAST_FORCE_N = 1e-12


@dataclass(frozen=True, eq=False)
class Travel:
    """depth (n_times,) mm, force (n_times,) N, compression positive; note : what they are relative to."""

    depth: Array
    force: Array
    note: str
    touches: bool


def travel(body: str, table: Table) -> Travel:
    """Travel since first contact along the axis of which the table holds place and force.

    The place of first contact is where the line through the first two states with force meets force 0, but
    not outside the step in which the force begins.

    table : must have the fields z and Fz
    """
    axes = [axis for axis in AXES if {axis, f"F{axis}"} <= set(table.fields)]
    moved = {axis: table.column(axis)[:, 0] - table.column(axis)[0, 0] for axis in axes}
    axis = max(axes, key=lambda each: (float(np.abs(moved[each]).max()), each))
    path = moved[axis]
    sign = float(np.sign(path[np.argmax(np.abs(path))])) or -1.0
    depth, force = sign * path, sign * table.column(f"F{axis}")[:, 0]
    acting = np.abs(force) > max(_NO_FORCE * float(np.abs(force).max()), _LEAST_FORCE_N)
    way = f"{'+' if sign > 0 else '-'}{axis}"
    if not acting.any():
        note = f"no force acts on {body} in any step: depth_mm is its travel along {way} from the start"
        return Travel(depth, force, note, touches=False)
    start = _first_contact(depth, force, int(np.argmax(acting)))
    note = f"depth_mm is the travel of {body} along {way} since first contact, {start:.3g} mm from its start"
    return Travel(depth - start, force, note, touches=True)


def _first_contact(depth: Array, force: Array, first: int) -> float:
    """Depth (mm) at which the force begins; `first` is the first state that has one."""
    if first == 0:
        return float(depth[0])
    before, now = float(depth[first - 1]), float(depth[first])
    guess = before
    if first + 1 < len(depth) and force[first + 1] != force[first]:
        slope = (depth[first + 1] - now) / (force[first + 1] - force[first])
        guess = now - float(force[first] * slope)
    return float(np.clip(guess, min(before, now), max(before, now)))
