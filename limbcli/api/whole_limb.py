"""limb and socket: from the surfaces of a limb to the model of the whole limb, and that in its socket."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path
from limbcli.api.geometry import thickness
from limbcli.api.stage_result import Result, one
from limbcli.numbers.mesh_bounds import (
    LIMB_CUT_MM,
    LIMB_NODES,
    LIMB_SITE_SIZE_MM,
    SOCKET_PENALTY,
    SOCKET_PENETRATION_MM,
    SOCKET_STEPS,
)
from limbcli.options import C_KPA, CASE, ELEMENT, OUT, PROGRESS, TEMPLATES, WAIT, Option
from limbcli.results import StageResult
from limbcli.stages.in_socket.intervals import PatchPressure

if TYPE_CHECKING:
    from limbcli.model import LimbModel


def _patches(found: StageResult) -> tuple[str, ...]:
    known = found.data["surfaces"]
    return tuple(each.removeprefix("patch_") for each in known if each.startswith("patch_"))


@dataclass(frozen=True, eq=False)
class LimbResult(Result):
    """The model of a whole limb. `table()` has one row.

    Attributes
    ----------
    element : "tet10" or "tet4"
    n_cells, n_nodes : number of elements and nodes
    size_mm : usual edge length
    min_angle_deg : smallest dihedral angle
    volume_cm3 : volume of the tissue
    c_kpa, f_kappa, m : of the tissue; means over the limb where every element has its own
    bones : the rigid bodies
    patches : named patches of the skin; those that cannot be placed are in `missing`, with the reason
    """

    stage: ClassVar[str] = "limb"
    element: str
    n_cells: int
    n_nodes: int
    size_mm: float
    min_angle_deg: float = field(metadata={"from": "quality/min_angle_deg"})
    volume_cm3: float
    c_kpa: float = field(metadata={"from": "stiffness/c_kpa"})
    f_kappa: float = field(metadata={"from": "stiffness/f_kappa"})
    m: float = field(metadata={"from": "stiffness/m"})
    bones: tuple[str, ...]
    patches: tuple[str, ...] = field(metadata={"from": _patches})
    missing: dict[str, str] = field(metadata={"from": "missing_parts"})

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(self._fields("bones", "patches", "missing"))]

    def model(self) -> LimbModel:
        """The model at rest, with its named surfaces and node sets."""
        from limbcli.model.npz_file import load_model

        return load_model(self.files["model"])


@one(LimbResult)
def limb(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    element: Annotated[Literal["tet10", "tet4"] | None, ELEMENT] = None,
    nodes: Annotated[
        int, Option("Approximate number of nodes; the edge length follows from it.", LIMB_NODES)
    ] = 40_000,
    site_size_mm: Annotated[
        float | None,
        Option(
            "Edge length under a probe at the sites, mm, such as 2.5, growing from there as in their own "
            "meshes; default: no finer than elsewhere.",
            LIMB_SITE_SIZE_MM,
        ),
    ] = None,
    cut_mm: Annotated[
        float | None,
        Option(
            "Height of the proximal cut above the distal end, mm; default: where the images end.", LIMB_CUT_MM
        ),
    ] = None,
    distal_cut: Annotated[
        bool, Option("Accept a limb whose distal end was not imaged; the cut there stays free.")
    ] = False,
    skin_mm: Annotated[
        float | Literal["mri"] | None,
        Option(
            "Thickness of a skin layer, 0 for none; default: the sites'.",
            metavar="MM|mri",
            kind=str,
            python='Thickness of a skin layer all over the limb, 0 for none, "mri": as segmented; default: '
            "the mean of the sites'.",
        ),
    ] = None,
    fat_mm: Annotated[
        float | Literal["mri"] | None,
        Option("The same for a fat layer below the skin.", metavar="MM|mri", kind=str),
    ] = None,
    c_kpa: Annotated[float | None, C_KPA] = None,
    draws: Annotated[
        Sequence[int],
        Option(
            "Also write the model of this random draw (0 to 49) of the stiffness field. May be repeated.",
            flag="--draw",
            kind=list[int],
            python="Numbers (0 to 49) of draws of the stiffness field whose models are written too.",
        ),
    ] = (),
    cohort: Annotated[
        PathLike | None,
        Option(
            "Folder that `cohort` wrote: its population is the prior of the stiffness far from all sites.",
            metavar="FOLDER",
        ),
    ] = None,
    cohort_location: Annotated[
        str | None, Option("Location of the cohort; default: the only one.", metavar="NAME")
    ] = None,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Build the finite-element model of the whole limb, with named parts. Requires `segment`.

    Raises
    ------
    CaseError
        If `segment` has not been run since its inputs changed, the limb cannot be meshed as it is (cut at
        both ends, no bones, a bone outside the skin), its stiffness is unknown, or an argument is invalid.
    MeshError
        If no volume mesh of sufficient quality could be generated.

    Source: docs/limb.md has the definition of every named part.
    """
    from limbcli.stages import limb as stage

    options = stage.LimbOptions(
        element=element, nodes=nodes, cut=cut_mm, distal_cut=distal_cut, c_kpa=c_kpa, site_size=site_size_mm,
        skin_layer=thickness(skin_mm, "skin_mm"), fat_layer=thickness(fat_mm, "fat_mm"), draws=tuple(draws),
        cohort=maybe_path(cohort, "cohort"), cohort_location=cohort_location,
    )  # fmt: skip
    with at_work(case, out, wait=wait, progress=progress, images_only=True) as work:
        return work.run(stage.limb, options=options, templates=templates)


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
    ] = 100.0,
    penetration_mm: Annotated[
        float,
        Option(
            "How far the skin may lie behind the wall (augmented contact); 0: as far as the penalty allows.",
            SOCKET_PENETRATION_MM,
        ),
    ] = 0.0,
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
