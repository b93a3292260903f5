"""The table [socket] of case.toml: the socket, how the limb is donned and loaded."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limbcli.case import schema as schema
from limbcli.case.parts import point
from limbcli.case.reading import CaseReading
from limbcli.numbers.units import mpa_from_kpa

if TYPE_CHECKING:
    from limbcli.case import Case

_FROM_SKIN = ("rectifications_mm", "all_mm", "transition_mm", "brim_mm", "flare_mm")
_rectification = schema.number(-20.0, 20.0, "mm")
_FEWEST = 3  # landmarks that determine a pose
# Tables of any keys within [socket] as JSON Schemas, by key.
INNER: Mapping[str, dict[str, Any]] = {
    "landmarks": {
        "type": "object", "additionalProperties": schema.JSON[schema.vector], "minProperties": _FEWEST,
    },
    "rectifications_mm": {"type": "object", "additionalProperties": schema.JSON[_rectification]},
}  # fmt: skip
_LEAST_APART_N = 0.1  # loads that differ by less would share a name in tables and files


@dataclass(frozen=True)
class LinerInput:
    """thickness : mm; youngs_modulus : MPa; poisson : its ratio at rest
    bonded : to the skin; else it slides on it, with `friction` (None: the socket's)
    """

    thickness: float
    youngs_modulus: float
    poisson: float
    bonded: bool = True
    friction: float | None = None


@dataclass(frozen=True)
class KneeInput:
    """What the thigh does to the limb at the knee centre, besides the force along the limb.

    centre : patient LPS, mm; None: that of the tibia's upper end
    anterior, lateral : N; about_anterior, about_lateral : N mm, right-handed about these directions
    """

    centre: tuple[float, float, float] | None
    anterior: float
    lateral: float
    about_anterior: float
    about_lateral: float


@dataclass(frozen=True, kw_only=True)
class SocketInput:
    """A socket as the case gives it.

    surface : file of the inner face or the wall; None: made from the skin by the rectifications
    align : bring it onto the skin by its shape
    landmarks : by the limb's names, points (x, y, z) in the socket's frame, mm
    rectifications : by patch, mm; positive: into the limb; `all_mm` of the whole skin
    transition : mm; brim : height (mm) of its upper end above the limb's distal end; None: chosen
    flare : mm outward at that end
    liner : on the skin, or None
    friction, friction_deviation : coefficient and its standard deviation
    tilt_deviation, shift_deviation : standard deviations of the socket's place on the limb, deg and mm, about
        and along each of the two directions across the limb
    knee : shear and moment at the knee centre, or None
    loads : forces along the limb, N
    limb_nodes : about this number of nodes of the limb's model that a batch makes
    """

    surface: Path | None
    align: bool
    landmarks: Mapping[str, tuple[float, float, float]]
    rectifications: Mapping[str, float]
    all_mm: float
    transition: float
    brim: float | None
    flare: float
    friction: float
    friction_deviation: float
    loads: tuple[float, ...]
    limb_nodes: int
    liner: LinerInput | None = None
    tilt_deviation: float = 0.0
    shift_deviation: float = 0.0
    knee: KneeInput | None = None


def read_socket(raw: Mapping[str, Any], reading: CaseReading) -> SocketInput | None:
    """The socket of a case; None if it gives none, or its table has problems."""
    if "socket" not in raw or _lifts(raw["socket"], reading):
        return None
    own = reading.part()
    values = own.table(raw["socket"], schema.SOCKET, "socket")
    if not values:
        return None
    surface = own.existing(values["surface"], "socket: surface", is_folder=False)
    liner, knee = _liner(values["liner"], own), _knee(values["knee"], own)
    _check_agreement(values, own)
    landmarks = _points(values["landmarks"] or {}, own)
    rectifications = _amounts(values["rectifications_mm"] or {}, own)
    if own.problems:
        return None
    transition, brim, flare = (values[f"{name}_mm"] for name in ("transition", "brim", "flare"))
    return SocketInput(
        surface=surface,
        align=values["align"],
        landmarks=landmarks,
        rectifications=rectifications,
        all_mm=float(values["all_mm"] or 0.0),
        transition=15.0 if transition is None else float(transition),
        brim=None if brim is None else float(brim),
        flare=3.0 if flare is None else float(flare),
        friction=float(values["friction"]),
        friction_deviation=float(values["friction_deviation"]),
        loads=tuple(float(each) for each in values["loads_n"]),
        limb_nodes=values["limb_nodes"],
        liner=liner,
        tilt_deviation=float(values["tilt_deviation_deg"]),
        shift_deviation=float(values["shift_deviation_mm"]),
        knee=knee,
    )


def socket_of(case: Case) -> SocketInput | None:
    """The socket of a case; None if it has none, or a faulty one."""
    return read_socket(case.raw, CaseReading.of(case.raw, case.folder))


def _lifts(table: object, reading: CaseReading) -> bool:
    """Whether a load would lift the limb out of its socket."""
    loads = table.get("loads_n") if isinstance(table, Mapping) else None
    for load in loads if isinstance(loads, list) else ():
        if isinstance(load, int | float) and load < 0:
            what = f"socket.loads_n has {load:g} N, which lifts the limb out: nothing holds it in the socket"
            reading.wrong(what, "give the forces that press the limb into it, above 0 N")
            return True
    return False


def _check_agreement(values: Mapping[str, Any], reading: CaseReading) -> None:
    """Keys must not contradict each other."""
    for low, high in itertools.pairwise(values["loads_n"]):
        if high - low < _LEAST_APART_N - 1e-9:
            what = f"socket.loads_n has {high:g} N after {low:g} N"
            fix = f"give loads in ascending order, each once, at least {_LEAST_APART_N:g} N apart"
            reading.wrong(what, fix)
            break
    if values["surface"] is None:
        for key in ("align", "landmarks"):
            if values[key]:
                what = f"[socket] has {key} but no surface that it could move"
                reading.wrong(what, f'add `surface = "socket.stl"`, or remove {key}')
        return
    for key in _FROM_SKIN:
        if values[key] is not None:
            what = f"[socket] has a surface and {key}, which makes a socket from the skin"
            reading.wrong(what, f"remove one of the two: surface or {key}")
    if values["align"] and values["landmarks"]:
        what = "[socket] has landmarks and align, two ways to place the socket"
        reading.wrong(what, "remove one of the two")


def _liner(table: object, reading: CaseReading) -> LinerInput | None:
    if table is None:
        return None
    own = reading.part()
    values = own.table(table, schema.LINER, "socket.liner")
    if not own.problems and values["bonded"] and values["friction"] is not None:
        what = "[socket.liner] has a friction on the skin, to which the liner is bonded"
        own.wrong(what, "add `bonded = false`, or remove friction")
    if own.problems:
        return None
    return LinerInput(
        thickness=float(values["thickness_mm"]),
        youngs_modulus=mpa_from_kpa(float(values["youngs_modulus_kpa"])),
        poisson=float(values["poisson"]),
        bonded=values["bonded"],
        friction=None if values["friction"] is None else float(values["friction"]),
    )


def _knee(table: object, reading: CaseReading) -> KneeInput | None:
    if table is None:
        return None
    own = reading.part()
    values = own.table(table, schema.KNEE, "socket.knee")
    if own.problems:
        return None
    centre, mm = values["centre_mm"], 1e3
    return KneeInput(
        centre=None if centre is None else point(centre),
        anterior=float(values["anterior_n"]),
        lateral=float(values["lateral_n"]),
        about_anterior=mm * float(values["about_anterior_n_m"]),
        about_lateral=mm * float(values["about_lateral_n_m"]),
    )


def _points(table: Mapping[str, Any], reading: CaseReading) -> dict[str, tuple[float, float, float]]:
    points = {}
    for name, each in table.items():
        if wrong := schema.vector(each):
            fix = "give the landmark's place in the socket's frame, mm"
            reading.wrong(f"socket.landmarks.{name} {wrong}", fix)
        else:
            points[name] = point(each)
    if table and len(table) < _FEWEST:
        what = f"[socket.landmarks] has {len(table)} of the {_FEWEST} or more points that place a socket"
        reading.wrong(what, "add points, by the names of the limb's landmarks")
    return points


def _amounts(table: Mapping[str, Any], reading: CaseReading) -> dict[str, float]:
    wrong = {name: text for name, each in table.items() if (text := _rectification(each))}
    for name, text in wrong.items():
        reading.wrong(f"socket.rectifications_mm.{name} {text}", "give mm, positive into the limb")
    return {name: float(each) for name, each in table.items() if name not in wrong}
