"""A limb in its socket: donning, then load along the limb's axis.

The socket is a rigid body. It is drawn where it ends up after donning, and thus inside the skin where it is
tight. During donning the penalty of the contact grows from nearly 0, by equal ratios, to its full value, so
that each step takes up a part of the interference; friction acts from the beginning. Then the socket is
free along the axis and pressed onto the limb by a force; its other motions stay fixed.

Between donning and the first load the force along the axis falls from the reaction of donning to 0: the limb
settles in the socket as far as friction lets it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from limbcli.errors import CaseError, MeshError, SolveError
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, Block, Curve, IntArray, LimbModel, LogRecord, Mesh, Step, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.model.npz_file import model_hash
from limbcli.progress import SILENT, Progress
from limbcli.sockets.knee import KneeLoad
from limbcli.sockets.liner import LINER_INSIDE
from limbcli.solvers.reference import prepare
from limbcli.solvers.restart import Restart

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.contacts.patch import Patch
    from limbcli.fem.motion.state import Forces, State
    from limbcli.fem.system import System

SOCKET, FACE = "socket", "socket_face"
_DONNING, _CLOSING, _LOAD = "donning", "closing", "socket_load"
_KNEE, _RELEASE = "knee_load", "socket_release"
_ABOUT = {"x": "u", "y": "v", "z": "w"}
_FIRST_PENALTY = 1e-4  # of the full one: about a hundredth of a limb's own stiffness
_OPEN = 1e6  # of the penetration's tolerance: before the end of donning each step sets the multipliers once
_MOST_AUGMENTATIONS = 20
_MOST_REFORMATIONS = 25
# FEBio shortens the steps that follow one of more iterations than this, counted over all its augmentations;
# the number of steps changes the friction
_ANY_ITERATIONS = _MOST_REFORMATIONS * (_MOST_AUGMENTATIONS + 1)
_SAME_TIME = 1e-9
_CELL_FIELDS = ("E1", "sed")
_SKIN = "skin"
# Pressure under a liner that slides from which skin counts as loaded: ten times that of its tightness.
LEAST_MPA = 1e-4
_LEAST_N = 1e-3  # of a contact: less is rounding, as of a socket of the skin's own shape


@dataclass(frozen=True, kw_only=True)
class DonningOptions:
    """How the limb is put into its socket and loaded.

    friction : between skin (or liner) and socket. 0.3 is a choice: its source has not been read in full
    loads_n : forces that press the socket onto the limb, one after the other, N
    axis, sign : direction of this force on the socket, along an axis of the model
    donning_steps, load_steps : time steps of donning, and of each load
    penalty : of the contact, as a multiple of the tissue's stiffness at rest
    penetration_mm : augmented Lagrangian contact, until the skin lies at most this far behind the wall;
        None: penalty alone
    search_radius_mm : the contact sees the socket within this distance: more than the interference
    skin : the limb's surface that meets the socket: "skin", or the liner's
    liner_slides : the liner slides on the surface "skin"; pressure and shear are then those on the skin
    liner_friction : between skin and a liner that slides; None: as `friction`
    slip_as_febio : the reference solver loses friction with every time step as FEBio does, to compare the two
    knee : shear and moment at the knee centre, full from the first load on: the socket is then free to move
        and turn, but not to turn about the axis
    """

    friction: float = 0.3
    loads_n: tuple[float, ...] = (400.0, 800.0)
    axis: Literal["x", "y", "z"] = "z"
    sign: float = 1.0
    donning_steps: int = 10
    load_steps: int = 5
    penalty: float = 100.0
    penetration_mm: float | None = None
    search_radius_mm: float = 30.0
    skin: str = "skin"
    liner_slides: bool = False
    liner_friction: float | None = None
    slip_as_febio: bool = False
    knee: KneeLoad | None = None

    @property
    def skin_friction(self) -> float:
        """Between skin and a liner that slides."""
        return self.friction if self.liner_friction is None else self.liner_friction


@dataclass(frozen=True, eq=False)
class SocketState:
    """The limb after donning (`load_n` 0) or under a load.

    pressure_mpa, shear_mpa (n_skin,) : at the skin's nodes, per current area; shear is the size of the mean
        tangential traction. With a liner that slides also at its outside, between liner and socket
    facet_pressure_mpa, facet_shear_mpa, facet_area_mm2 (n_facets,) : means over each facet, and its current
        area where it is in contact (else that at rest), in the surface's order; of a bonded liner those
        outside, of one that slides those of the skin, 0 where it presses less than `LEAST_MPA`
    displacements (n_points, 3) : mm, of all nodes of `socket_model`
    strain, energy_density (n_cells,) : largest principal Green-Lagrange strain, and MPa
    socket_force_n (3,), socket_moment_n_mm (3,) : on the socket from outside, about its centre
    socket_shift_mm, centre (3,) : of the socket's centre, and its place then
    penetration_mm : largest depth of the skin behind the wall, which the penalty allows
    imbalance_n : size of the sum of all forces from outside: on the socket, the bones and held nodes
    """

    load_n: float
    pressure_mpa: Array
    shear_mpa: Array
    facet_pressure_mpa: Array
    facet_shear_mpa: Array
    facet_area_mm2: Array
    displacements: Array
    strain: Array
    energy_density: Array
    socket_force_n: Array
    socket_moment_n_mm: Array
    socket_shift_mm: Array
    penetration_mm: float
    imbalance_n: float
    centre: Array

    def moment_about(self, point: Array) -> Array:
        """Moment (3,) on the socket from outside about a point (3,), N mm."""
        return np.asarray(self.socket_moment_n_mm + np.cross(self.centre - point, self.socket_force_n))


@dataclass(frozen=True)
class StepBalance:
    """What all forces from outside (on the socket, the bones and held nodes) leave over at a load step.

    aim : what the step leads to, in words; contact_n : sum of pressure times area on the skin, N
    left_n, left_n_mm : size of the sum of the forces, and of that of their moments about the socket's centre,
        without the couple that friction makes over the penetration
    arm_mm : of the moments: half of the socket's diagonal
    """

    aim: str
    contact_n: float
    left_n: float
    left_n_mm: float
    arm_mm: float

    @property
    def share(self) -> float:
        """The larger of both, as a share of the contact's force (of `_LEAST_N` if that is less) and of that
        times the arm."""
        return max(self.left_n, self.left_n_mm / self.arm_mm) / max(self.contact_n, _LEAST_N)


@dataclass(frozen=True, eq=False)
class DonningResult:
    """skin_nodes (n_skin,) : node numbers, ascending; states : after donning, then one per load;
    balance : one per load step."""

    model: LimbModel
    skin_nodes: IntArray
    states: tuple[SocketState, ...]
    balance: tuple[StepBalance, ...]

    @property
    def worst(self) -> StepBalance:
        """The load step whose forces or moments leave most over."""
        return max(self.balance, key=lambda each: each.share)


def socket_model(limb: LimbModel, face: Triangles, options: DonningOptions | None = None) -> LimbModel:
    """The limb's model with its socket: everything a solver needs, also as `socket.feb`.

    limb : solids, laws and supports: bones and proximal cut held; without contacts
    face : inner face in the limb's frame, mm, normals towards the limb

    Raises CaseError if the limb has no such skin, holds contacts or a body named `socket`, or an option is
    out of range.
    """
    options = options or DonningOptions()
    _check(limb, options)
    n = len(limb.mesh.points)
    centre = np.average(face.centroids, axis=0, weights=face.areas)
    facets = (face.faces + n).astype(np.int64)
    mesh = Mesh(
        np.concatenate([limb.mesh.points, face.points]),
        (*limb.mesh.blocks, Block(SOCKET, "tri3", facets)),
        limb.mesh.node_sets,
        {**limb.mesh.surfaces, FACE: Surface(FACE, {"tri3": facets})},
    )
    contact = Contact(
        primary=options.skin,
        secondary=FACE,
        name="socket_contact",
        penalty=options.penalty,
        search_radius=options.search_radius_mm,
        friction=options.friction,
        symmetric=False,
        penalty_curve=_DONNING,
        augmented=options.penetration_mm is not None,
        tolerance=0.0,
        gap_tolerance=options.penetration_mm or 0.0,
        gap_tolerance_curve=_CLOSING if options.penetration_mm else None,
        more={"maxaug": f"{_MOST_AUGMENTATIONS}"} if options.penetration_mm else {},
    )
    contacts: tuple[Contact, ...] = (contact,)
    if options.liner_slides:
        contacts += (
            replace(
                contact, primary=_SKIN, secondary=LINER_INSIDE, name="liner_contact",
                friction=options.skin_friction, penalty_curve=None,
            ),
        )  # fmt: skip
    return replace(
        limb,
        mesh=mesh,
        bodies=(*limb.bodies, RigidBody(SOCKET, (centre[0], centre[1], centre[2]), (SOCKET,))),
        contacts=contacts,
        curves={**limb.curves, **_curves(options)},
        steps=_steps(options, centre),
    )


def don_and_load(
    limb: LimbModel,
    face: Triangles,
    options: DonningOptions | None = None,
    *,
    threads: int = 2,
    keep: Path | None = None,
    progress: Progress = SILENT,
) -> DonningResult:
    """Put a limb into its socket and load it, with the reference solver. Progress says what each step leads
    to ("donned 40 %", "50 % of the way to 400 N").

    limb, face, options : as for `socket_model`
    keep : folder in which an unfinished run leaves its converged load steps, from which the next run of the
        same model goes on; None: nothing is kept

    Raises CaseError as `socket_model`; MeshError if the donned socket touches the skin nowhere, and there are
    loads; SolveError if the model holds what the solver does not support, or a step has no equilibrium.
    """
    options = options or DonningOptions()
    model = socket_model(limb, face, options)
    analysis = prepare(model, _told(progress, options), threads=threads, slip_as_febio=options.slip_as_febio)
    restart = None if keep is None else Restart(keep, model_hash(model).encode(), f"{options.slip_as_febio}")
    if restart is not None and restart.n_stored:
        progress.event("note", text=f"starting from {restart.n_stored} load steps that are already solved")
    states: list[SocketState] = []
    balance: list[StepBalance] = []
    arm = 0.5 * float(np.linalg.norm(np.ptp(face.points, axis=0)))
    loads = iter((0.0, *options.loads_n))

    def visit(running: Analysis, snapshot: Snapshot) -> None:
        balance.append(_balance(running, snapshot, aim_of(snapshot.state.time, options), arm))
        if restart is not None:
            restart.keep(snapshot.state)
        if not snapshot.must:
            return
        states.append(_state(running, snapshot, next(loads)))
        if options.loads_n and not states[1:] and not balance[-1].contact_n:
            raise MeshError(
                "the donned socket touches the skin nowhere: a load along the limb has nothing to act on",
                where="socket",
                fix="check its place: a socket from a file may lie too low, or be too wide for this limb; "
                "one made from the skin is made tighter with all_mm or rectifications_mm",
            )
        if len(states) == 1 and len(running.model.steps) > 1:
            running.model = with_gradual_release(running.model, states[0])

    try:
        analysis.run(visit, guesses=restart.guess if restart is not None else None)
    except SolveError as error:
        raise _explained(error, len(states), options) from error
    finally:
        analysis.close()
    if restart is not None and keep is not None:
        restart.finished()
        with contextlib.suppress(OSError):  # other files lie there
            keep.rmdir()
    return DonningResult(analysis.model, _skin_nodes(model), tuple(states), tuple(balance))


# ---------------------------------------------------------------- model


def _check(limb: LimbModel, options: DonningOptions) -> None:
    wrong, fix = "", "correct it"
    if options.skin not in limb.mesh.surfaces:
        wrong, fix = f"the limb has no surface {options.skin!r}", f"use one of {sorted(limb.mesh.surfaces)}"
    elif limb.contacts or any(body.name == SOCKET for body in limb.bodies):
        wrong, fix = "the limb's model already holds a contact or a socket", "give the limb alone"
    elif options.liner_slides and LINER_INSIDE not in limb.mesh.surfaces:
        wrong, fix = "the limb has no liner that slides", "make it with `with_liner`, not bonded"
    elif (
        min(options.friction, options.skin_friction) < 0
        or options.penalty <= 0
        or options.search_radius_mm <= 0
    ):
        wrong = "friction is below 0, or penalty or search radius is not above 0"
    elif options.penetration_mm is not None and options.penetration_mm <= 0:
        wrong = f"the penetration of {options.penetration_mm:g} mm is not above 0"
    elif options.donning_steps < 1 or options.load_steps < 1:
        wrong = "there is no step for donning or for a load"
    elif abs(options.sign) != 1.0:
        wrong = f"the sign of the force's direction is {options.sign:g}, neither 1 nor -1"
    elif any(load <= 0 for load in options.loads_n):
        wrong, fix = "a load does not press the socket onto the limb", "give forces above 0 N"
    if wrong:
        raise CaseError(wrong, where="socket", fix=fix)


def _curves(options: DonningOptions) -> dict[str, Curve]:
    n = options.donning_steps
    ratios = [_FIRST_PENALTY ** (1.0 - (k + 1) / n) for k in range(n)] if n > 1 else [1.0]
    growth = ((0.0, _FIRST_PENALTY), *(((k + 1) / n, ratio) for k, ratio in enumerate(ratios)))
    load = ((0.0, 0.0), (1.0, 0.0), *((2.0 + k, load) for k, load in enumerate(options.loads_n)))
    curves = {_DONNING: Curve(growth), _LOAD: Curve(load)}
    if options.penetration_mm:
        before = (n - 1) / n
        opening = ((0.0, _OPEN), *(((before, _OPEN),) if before else ()), (1.0, 1.0))
        curves[_CLOSING] = Curve(opening)
    if options.knee is not None:
        curves[_KNEE] = Curve(((0.0, 0.0), (1.0, 0.0), (2.0, 1.0)))
    return curves


def _steps(options: DonningOptions, centre: Array) -> tuple[Step, ...]:
    def fixed(dofs: Sequence[str]) -> tuple[Drive, ...]:
        return tuple(Drive(SOCKET, dof, "fixed") for dof in dofs)  # type: ignore[arg-type]

    # FEBio's matrix is unsymmetric in this contact; quasi-Newton updates of a symmetric one diverge, with
    # friction and in augmented contact without
    control = {
        "symmetric_stiffness": "non-symmetric",
        "max_refs": _MOST_REFORMATIONS,
        "qn_method": "Broyden",
        "max_ups": 10,
    }
    others = [dof for dof in ("x", "y", "z", "u", "v", "w") if dof != options.axis]
    donning = Step(
        n_steps=options.donning_steps,
        step_size=1.0 / options.donning_steps,
        dt_max=1.0 / options.donning_steps,
        opt_iterations=_ANY_ITERATIONS,
        must_points=(1.0,),
        control=control,
        drives=fixed([options.axis, *others]),
    )
    if not options.loads_n:
        return (donning,)
    push = Drive(SOCKET, options.axis, "force", options.sign, _LOAD)
    at_knee = _knee_drives(options, centre)
    if at_knee:
        others = [_ABOUT[options.axis]]
    loading = Step(
        n_steps=options.load_steps * len(options.loads_n),
        step_size=1.0 / options.load_steps,
        dt_max=1.0 / options.load_steps,
        opt_iterations=_ANY_ITERATIONS,
        must_points=tuple(float(k + 1) for k in range(len(options.loads_n))),
        control=control,
        drives=(*fixed(others), push, *at_knee),
    )
    return donning, loading


def with_gradual_release(model: LimbModel, donned: SocketState) -> LimbModel:
    """The model whose loading begins with the forces and moments that hold the socket where it was donned:
    they pass over into the first load. Let go at once, the limb would spring back, and skin that sticks
    would slip."""
    donning, loading = model.steps
    held = dict(zip("xyzuvw", (*donned.socket_force_n, *donned.socket_moment_n_mm), strict=True))
    free = {drive.dof: drive.kind for drive in loading.drives if drive.kind in ("force", "moment")}
    still = [Drive(SOCKET, dof, kind, float(held[dof]), _RELEASE) for dof, kind in free.items()]  # type: ignore[arg-type]
    curves = {**model.curves, _RELEASE: Curve(((0.0, 1.0), (1.0, 1.0), (2.0, 0.0)))}
    return replace(model, curves=curves, steps=(donning, replace(loading, drives=(*loading.drives, *still))))


def for_febio(model: LimbModel) -> LimbModel:
    """The model of `DonningResult` with the load steps in which FEBio finds its pressures: half of them where
    there is friction by the penalty alone.

    Each step of such contact forgets the shear of the steps before. FEBio forgets twice in every step, as it
    measures the step's shear anew from where the first iterate ends (FEBio 4.11, its pressures with N steps
    and those of the reference solver with 2 N: `tests/benchmarks/figures/socket.md`).
    """
    if not model.has_friction or any(each.augmented for each in model.contacts):
        return model
    return replace(model, steps=tuple(_halved(step) for step in model.steps))


def _halved(step: Step) -> Step:
    in_unit = -(-round(1.0 / step.step_size) // 2)  # rounded up
    n_units = round(step.n_steps * step.step_size)
    size = 1.0 / in_unit
    return replace(step, n_steps=in_unit * n_units, step_size=size, dt_max=size)


def _knee_drives(options: DonningOptions, centre: Array) -> tuple[Drive, ...]:
    """Forces across the axis, and moments about the socket's centre: of the load at the knee, and of the
    force along the limb, which acts through the knee centre too."""
    knee = options.knee
    if knee is None:
        return ()
    along = options.sign * np.eye(3)["xyz".index(options.axis)]
    of_push = np.cross(np.asarray(knee.centre) - centre, along)
    of_knee = knee.moment_about(centre)
    drives = []
    for k, dof in enumerate("xyz"):
        if dof == options.axis:
            continue
        drives.append(Drive(SOCKET, dof, "force", float(knee.force[k]), _KNEE))  # type: ignore[arg-type]
        about = _ABOUT[dof]
        drives.append(Drive(SOCKET, about, "moment", float(of_knee[k]), _KNEE))  # type: ignore[arg-type]
        drives.append(Drive(SOCKET, about, "moment", float(of_push[k]), _LOAD))  # type: ignore[arg-type]
    return tuple(drives)


def _told(progress: Progress, options: DonningOptions) -> Progress:
    """The same progress, whose load steps say how far the limb is donned, or the load."""

    def tell(kind: str, facts: dict[str, Any]) -> None:
        more = {"aim": aim_of(facts["time"], options)} if kind == "newton" else {}
        progress.event(kind, **{**facts, **more})

    return Progress(tell)


def aim_of(time: float, options: DonningOptions) -> str:
    """What is reached at a time: donning ends at 1, and each load 1 later. Without friction the solver takes
    fewer steps than the options say.

    >>> options = DonningOptions(loads_n=(400.0, 800.0))
    >>> aim_of(0.4, options), aim_of(1.4, options), aim_of(3.0, options)
    ('donned 40 %', '40 % of the way to 400 N', 'load 800 N')
    """
    if time < 1.0 + _SAME_TIME:
        return f"donned {100 * time:.0f} %"
    done = int(time - 1.0 + _SAME_TIME)
    share = time - 1.0 - done
    if share < _SAME_TIME or done >= len(options.loads_n):
        return f"load {options.loads_n[min(done, len(options.loads_n)) - 1]:.4g} N"
    return f"{100 * share:.0f} % of the way to {options.loads_n[done]:.4g} N"


def _explained(error: SolveError, n_states: int, options: DonningOptions) -> SolveError:
    """The error, with what was going on: donning, or which load."""
    what = "donning" if n_states == 0 else f"the load of {options.loads_n[n_states - 1]:g} N"
    fix = "use more donning steps; check the alignment and the interference"
    if n_states:
        fix = (
            "use more load steps or a smaller load: the limb may slide on into the socket, or out of it, "
            "where neither its shape nor friction holds it; near the brim, flare it more "
            "(flare_mm of a socket made from the skin)"
        )
    if options.liner_slides and not max(options.friction, options.skin_friction):
        fix = (
            "give the liner a friction on one of its faces, or bond it: without any only its shape holds it "
            "along the limb, and it slides out of the socket"
        )
    return SolveError(
        f"{what} has no equilibrium: {error.what}", where=error.where, fix=fix, n_states=n_states
    )


# ---------------------------------------------------------------- results


def _skin_nodes(model: LimbModel) -> IntArray:
    """The nodes at which something is pressed by the socket or a liner."""
    facets = [f for each in model.contacts for f in model.mesh.surfaces[each.primary].facets.values()]
    return np.unique(np.concatenate([each.ravel() for each in facets]))


def _state(running: Analysis, snapshot: Snapshot, load: float) -> SocketState:
    from limbcli.fem.record_fields import record_rows

    system, state, forces = running.system, snapshot.state, snapshot.forces
    nodes = _skin_nodes(running.model)
    sums = np.zeros((len(system.X), 2))  # area, and pressure times area
    shear = np.zeros((len(system.X), 3))
    for pair, found in zip(system.pairs, forces.contact.points, strict=True):
        by_facet: list[tuple[Array, Array, Array]] = []
        for patch, points in zip(pair.patches, found, strict=True):
            area, pressure, tangential = tractions(patch, points)
            by_facet.append((pressure, np.linalg.norm(tangential, axis=1), area))
            for column in patch.facets.T:
                np.add.at(sums, (column, 0), area)
                np.add.at(sums, (column, 1), area * pressure)
                np.add.at(shear, column, area[:, None] * tangential)
    facet_pressure, facet_shear, facet_area = (np.concatenate(each) for each in zip(*by_facet, strict=True))
    if len(system.pairs) > 1:
        loaded = facet_pressure >= LEAST_MPA
        facet_pressure, facet_shear = facet_pressure * loaded, facet_shear * loaded
    area = np.maximum(sums[nodes, 0], 1e-300)
    cells = record_rows(system, state, forces, LogRecord("element", _CELL_FIELDS, ""))[1]
    b = _socket_number(system)
    return SocketState(
        load_n=load,
        pressure_mpa=sums[nodes, 1] / area,
        shear_mpa=np.linalg.norm(shear[nodes], axis=1) / area,
        facet_pressure_mpa=facet_pressure,
        facet_shear_mpa=facet_shear,
        facet_area_mm2=facet_area,
        displacements=state.u.copy(),
        strain=cells[:, 0],
        energy_density=cells[:, 1],
        socket_force_n=forces.bodies[b, :3].copy(),
        socket_moment_n_mm=forces.bodies[b, 3:].copy(),
        socket_shift_mm=np.array(state.bodies[b].shift),
        penetration_mm=max(
            (_penetration(each) for found in forces.contact.points for each in found), default=0.0
        ),
        centre=np.asarray(system.bodies[b].center + state.bodies[b].shift),
        imbalance_n=float(np.linalg.norm(_left(system, state, forces)[0])),
    )


def _socket_number(system: System) -> int:
    return [body.name for body in system.bodies].index(SOCKET)


def _left(system: System, state: State, forces: Forces) -> tuple[Array, Array]:
    """Sums (3,) of all forces from outside, and of their moments about the socket's centre: of what holds
    nodes and bodies, and of the loads. What the solver left at free nodes is none of them, and so remains."""
    reactions = np.where(system.free, 0.0, forces.nodal)
    for body in system.bodies:
        reactions[body.tied] = 0.0  # they are in the forces of their bodies
    applied = system.applied(state.time)
    middle = system.center(_socket_number(system), state)
    force = reactions.sum(axis=0)
    moment = np.cross(system.X + state.u - middle, reactions).sum(axis=0)
    for b, body in enumerate(system.bodies):
        acting = forces.bodies[b].copy()
        acting[list(body.free)] = applied[b, list(body.free)]
        force = force + acting[:3]
        moment = moment + acting[3:] + np.cross(system.center(b, state) - middle, acting[:3])
    return force, moment


def _balance(running: Analysis, snapshot: Snapshot, aim: str, arm: float) -> StepBalance:
    system = running.system
    force, moment = _left(system, snapshot.state, snapshot.forces)
    x, points = system.X + snapshot.state.u, snapshot.forces.contact.points
    by_pair = [
        list(zip(pair.patches, each, strict=True)) for pair, each in zip(system.pairs, points, strict=True)
    ]
    couple = sum((_couple(patch, each, x) for found in by_pair for patch, each in found), np.zeros(3))
    pressed = sum(float(a @ p) for a, p, _ in starmap(tractions, by_pair[0]))
    return StepBalance(
        aim, pressed, float(np.linalg.norm(force)), float(np.linalg.norm(moment - couple)), arm
    )


def _couple(patch: Patch, points: Array, x: Array) -> Array:
    """Moment (3,) that friction makes because it acts on the skin at one point and on the wall at another, as
    far apart as the penetration. x (n_points, 3) : current places"""
    from limbcli.fem.contacts import friction_kernels
    from limbcli.fem.contacts.contact_points import NORMAL, POINT, TRACTION

    if points.shape[2] != friction_kernels.N_STATE:
        return np.zeros(3)
    size = np.linalg.norm(points[..., NORMAL : NORMAL + 3], axis=2)
    weight = np.where(points[..., TRACTION] > 0, patch.weights * size, 0.0)
    apart = np.einsum("ga,fai->fgi", patch.N, x[patch.facets]) - points[..., POINT : POINT + 3]
    push = points[..., friction_kernels.PUSH : friction_kernels.PUSH + 3]
    return np.asarray(np.einsum("fg,fgi->i", weight, np.cross(apart, push)))


def _penetration(points: Array) -> float:
    from limbcli.fem.contacts.contact_points import GAP, TRACTION

    gaps = points[..., GAP][points[..., TRACTION] > 0]
    return float(gaps.max(initial=0.0))


def tractions(patch: Patch, points: Array) -> tuple[Array, Array, Array]:
    """Current area (n_facets,; that at rest where no point touches), mean pressure (n_facets,) and mean
    tangential traction (n_facets, 3) of a patch.

    points (n_facets, n_gauss, n_columns) : its part of a `ContactState`
    """
    from limbcli.fem.contacts import friction_kernels
    from limbcli.fem.contacts.contact_points import NORMAL, TRACTION

    normal = points[..., NORMAL : NORMAL + 3]
    size = np.linalg.norm(normal, axis=2)
    touching = points[..., TRACTION] > 0
    weight = patch.weights * np.where(touching, size, 0.0)
    share = (patch.weights * touching).sum(axis=1) / patch.weights.sum()
    # points that do not touch hold no current area: that of those of the facet that do
    area = np.where(share > 0, weight.sum(axis=1) / np.maximum(share, 1e-300), patch.areas)
    pressure = (weight * points[..., TRACTION]).sum(axis=1) / area
    tangential = np.zeros((len(patch.facets), 3))
    if points.shape[2] == friction_kernels.N_STATE:
        push = points[..., friction_kernels.PUSH : friction_kernels.PUSH + 3]
        nu = normal / np.maximum(size, 1e-300)[..., None]
        along = (push * nu).sum(axis=2)[..., None] * nu
        tangential = np.einsum("fg,fgi->fi", weight, np.where(touching[..., None], push - along, 0.0))
        tangential /= area[:, None]
    return area, pressure, tangential
