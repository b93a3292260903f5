"""socket: the limb in its socket, donned and loaded."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from limbcli.api.call import CaseLike, Heard, PathLike, at_work
from limbcli.api.stage_result import Result, one
from limbcli.numbers.mesh_bounds import PENETRATION_MM, SOCKET_PENALTY, SOCKET_PENETRATION_MM, SOCKET_STEPS
from limbcli.options import CASE, OUT, PROGRESS, TEMPLATES, WAIT, Option
from limbcli.results import StageResult
from limbcli.stages.in_socket.patch_table import PatchPressure


@dataclass(frozen=True, eq=False)
class SocketResult(Result):
    """A limb in its socket. `table()` has one row per load and patch.

    Attributes
    ----------
    friction : coefficient between skin and socket
    loads_n : forces along the limb
    patches : pressure and shear by load and patch
    """

    stage: ClassVar[str] = "socket"
    friction: float
    loads_n: tuple[float, ...]
    patches: tuple[PatchPressure, ...] = field(
        metadata={"from": lambda found: tuple(PatchPressure(**each) for each in found.data["patches"])}
    )

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(vars(each)) for each in self.patches]


@one(SocketResult)
def socket(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    align: Annotated[
        bool, Option("Fit the socket of [socket] to the skin by its shape, if it is in another frame.")
    ] = False,
    donning_steps: Annotated[
        int, Option("Number of load steps in which the socket is put on.", SOCKET_STEPS)
    ] = 10,
    load_steps: Annotated[int, Option("Number of load steps of each load.", SOCKET_STEPS)] = 5,
    contact_penalty: Annotated[
        float,
        Option(
            "Contact penalty, as a multiple of the tissue's stiffness: a higher one is more accurate, and "
            "slower.",
            SOCKET_PENALTY,
        ),
    ] = 20.0,
    penetration_mm: Annotated[
        float,
        Option(
            "How far the skin may lie behind the wall (augmented contact); 0: as far as the penalty allows.",
            SOCKET_PENETRATION_MM,
        ),
    ] = PENETRATION_MM,
    intervals: Annotated[
        bool, Option("95 % limits of pressure and shear, from the limb's draws (up to twelve more solves).")
    ] = True,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Put the limb into its socket and load it along its axis. Requires `limb`.

    Raises
    ------
    CaseError
        If the case gives no socket, or the result of `limb` is missing or out of date.
    MeshError
        If the socket cannot be that of this limb: in another unit or frame, not around it, open, partly
        inside out, or too deep in it.
    SolveError
        If donning or a load has no equilibrium.
    """
    from limbcli.stages import socket as stage

    options = stage.SocketOptions(
        align, donning_steps, load_steps, contact_penalty, penetration_mm, intervals
    )
    with at_work(case, out, wait=wait, progress=progress, images_only=True) as work:
        return work.run(stage.socket, options=options, templates=templates)
