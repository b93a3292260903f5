"""segment and mesh: from images or surfaces to the local model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, public
from limbcli.api.limits import within
from limbcli.api.stage_result import Result, SiteResults, one
from limbcli.errors import CaseError
from limbcli.numbers.mesh_bounds import FAR_SIZE_MM, SIZE_MM
from limbcli.options import CASE, ELEMENT, MARGIN, OUT, PROGRESS, SITES, WAIT, Option
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel

Point = tuple[float, float, float]
SEEDS = Option(
    "A point (patient LPS, mm) in the marrow of a bone that was not found (bone=X,Y,Z), or in soft tissue "
    "that was taken for bone (soft=X,Y,Z). May be repeated.",
    flag="--seed", metavar="KIND=X,Y,Z", kind=list[str], such_as=("bone=", "soft="),
    python='Points (x, y, z) (patient LPS, mm), each with its kind: ("bone", point) in the marrow of a '
    'missed bone, ("soft", point) in soft tissue wrongly labelled as bone.',
)  # fmt: skip


@dataclass(frozen=True)
class Marker:
    """A skin marker: number (from distal to proximal), position (x, y, z) in patient LPS (mm), and volume."""

    number: int
    position_mm: Point
    volume_mm3: float


@dataclass(frozen=True, eq=False)
class SegmentResult(Result):
    """Result of `segment`. `table()` has one row per marker.

    Attributes
    ----------
    source : origin of the surfaces: "mri", "labels", "surfaces" or "edited labels"
    bones : names of the bones, such as "tibia"; `files["bone_tibia"]` is the surface
    volume_cm3 : volume enclosed by the skin and by each bone, by the surface's name
    markers : skin markers in the images
    """

    stage: ClassVar[str] = "segment"
    source: str
    bones: tuple[str, ...]
    volume_cm3: dict[str, float]
    markers: tuple[Marker, ...]

    @classmethod
    def of(cls, found: StageResult) -> Self:
        bones = (name.removeprefix("bone_") for name in found.files if name.startswith("bone_"))
        markers = tuple(
            Marker(each["number"], tuple(each["position_mm"]), each["volume_mm3"])
            for each in found.data.get("markers", ())
        )
        data = found.data
        return cls(
            found, str(data.get("source", "")), tuple(bones), dict(data.get("volume_cm3", {})), markers
        )

    def rows(self) -> list[dict[str, Any]]:
        return [
            self._named(
                {
                    "number": each.number, "x_mm": each.position_mm[0], "y_mm": each.position_mm[1],
                    "z_mm": each.position_mm[2], "volume_mm3": each.volume_mm3,
                }
            )
            for each in self.markers
        ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class MeshStudyResult(Result):
    """Result of the refinement study of a site (`mesh(study=True)`); its numbers are in `data`."""

    stage: ClassVar[str] = "mesh-study"


@dataclass(frozen=True, eq=False)
class MeshResult(Result):
    """The local model of a site. `table()` has one row.

    Attributes
    ----------
    element : "tet10" or "tet4"
    n_cells, n_nodes : number of elements and nodes of the tissue
    edge_under_probe_mm : mean edge length there
    min_angle_deg, min_angle_under_probe_deg : smallest dihedral angles
    skin_bone_mm : distance from skin to bone at the probe's centre; None if no bone is below it
    site_to_skin_mm : distance by which the site was moved onto the skin
    margin_mm : width of tissue kept beyond the probe
    study : the refinement study, if requested
    """

    stage: ClassVar[str] = "mesh"
    element: str
    n_cells: int = field(metadata={"from": "quality/n_cells"})
    n_nodes: int = field(metadata={"from": "quality/n_nodes"})
    edge_under_probe_mm: float = field(metadata={"from": "quality/edge_under_probe_mm"})
    min_angle_deg: float = field(metadata={"from": "quality/min_angle_deg"})
    min_angle_under_probe_deg: float = field(metadata={"from": "quality/min_angle_under_probe_deg"})
    skin_bone_mm: float | None = field(metadata={"from": "checks/skin_bone_mm"})
    site_to_skin_mm: float = field(metadata={"from": "frame/site_to_skin_mm"})
    margin_mm: float
    study: MeshStudyResult | None = field(default=None, metadata={"from": lambda found: None})

    @classmethod
    def of(cls, found: StageResult, study: MeshStudyResult | None = None) -> Self:
        return replace(super().of(found), study=study)

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(self._fields("study"))]

    def model(self) -> LimbModel:
        """The model: mesh, named sets and probe, without the tissue's parameters."""
        from limbcli.model.npz_file import load_model

        return load_model(self.files["model"])


@one(SegmentResult)
def segment(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    seeds: Annotated[Sequence[tuple[Literal["bone", "soft"], Point]], SEEDS] = (),
    smooth_mm: Annotated[
        float, Option("Smoothing of the surfaces, mm.", (0.0, 5.0), flag="--smooth", metavar="MM")
    ] = 0.7,
    threshold: Annotated[
        float | None,
        Option(
            "Signal that separates air from skin, in the image's units (HU on CT); default: found "
            "automatically.",
            metavar="SIGNAL",
        ),
    ] = None,
    limb: Annotated[
        Literal["left", "right"] | None,
        Option("Which limb to take, if the images show two; default: the case's.", metavar="left|right"),
    ] = None,
    accept_bones: Annotated[
        bool, Option("If a bone lies partly outside the skin, keep the part inside; default: it is an error.")
    ] = False,
    aop: Annotated[bool, Option("Also write skin.aop, the skin for prosthetic CAD programs.")] = False,
    fresh: Annotated[bool, Option("Discard a label map that was edited by hand and segment again.")] = False,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Segment an MRI or CT series, a label map or surfaces into skin, bones, fat and markers.

    A label map edited by hand in the output folder takes precedence over the automatic one.

    Raises
    ------
    CaseError
        If the case, one of its files, or an argument cannot be used.

    Source: each step cites its own, in `limbcli.imaging`.
    """
    from limbcli.stages import segment as stage

    with at_work(case, out, wait=wait, progress=progress, images_only=True) as work:
        options = stage.SegmentOptions(
            seeds=_seeds(seeds), smooth=smooth_mm, threshold=threshold, limb=limb, accept_bones=accept_bones,
            aop=aop,
        )  # fmt: skip
        return work.run(stage.segment, options=options, fresh=fresh)


def _with_studies(found: Sequence[StageResult]) -> SiteResults[MeshResult]:
    studies = {each.site: MeshStudyResult.of(each) for each in found if each.stage == MeshStudyResult.stage}
    meshed = (each for each in found if each.stage == MeshResult.stage)
    return SiteResults(tuple(MeshResult.of(each, studies.get(each.site)) for each in meshed))


@public(_with_studies, "SiteResults[MeshResult]")
def mesh(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    element: Annotated[Literal["tet10", "tet4"] | None, ELEMENT] = None,
    size_mm: Annotated[
        float | None, Option("Edge length of elements under the probe, mm; default: 2.5.", SIZE_MM)
    ] = None,
    far_size_mm: Annotated[
        float | None, Option("Edge length far from the probe, mm; default: 12, or --size-mm.", FAR_SIZE_MM)
    ] = None,
    margin_mm: Annotated[float | None, MARGIN] = None,
    skin_mm: Annotated[
        float | Literal["mri"] | None,
        Option(
            "Thickness of a skin layer, 0 for none; default: the case's.",
            metavar="MM|mri",
            kind=str,
            python='Thickness of a skin layer, 0 for none, "mri": as segmented; default: the case\'s.',
        ),
    ] = None,
    fat_mm: Annotated[
        float | Literal["mri"] | None,
        Option(
            "Thickness of a fat layer below the skin, 0 for none; mri: as segmented at the site; default: "
            "the case's.",
            metavar="MM|mri",
            kind=str,
        ),
    ] = None,
    at: Annotated[
        tuple[float, float] | None,
        Option(
            "Place the site by its angle around the limb (0: anterior, 90: the patient's left) and its "
            "height above the distal end, instead of the position in the case.",
            metavar="ANGLE_DEG HEIGHT_MM",
            kind=tuple[float, float],
        ),
    ] = None,
    study: Annotated[
        bool, Option("Also solve finer and coarser meshes and smaller and larger models (minutes).")
    ] = False,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> list[StageResult]:
    """Build the local finite-element model of each site from the surfaces. Requires `segment`.

    Raises
    ------
    CaseError
        If `segment` has not been run since its inputs changed, or an argument is invalid.
    MeshError
        If no volume mesh of sufficient quality could be generated.

    Source: the elements are those of Zienkiewicz, Taylor and Zhu, The Finite Element Method: Its Basis and
    Fundamentals, 7th ed., chapter 6.
    """
    place = _place(at)
    from limbcli.stages import mesh as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        request = stage.MeshRequest(
            element=element, size=size_mm, far_size=far_size_mm, margin=margin_mm, place=place,
            skin_layer=thickness(skin_mm, "skin_mm"), fat_layer=thickness(fat_mm, "fat_mm"),
        )  # fmt: skip
        return work.run(stage.mesh, sites=sites, options=request, study=study)


def _place(at: tuple[float, float] | None) -> tuple[float, float] | None:
    if at is None:
        return None
    if not isinstance(at, Sequence) or isinstance(at, str) or len(at) != 2:
        raise CaseError(f"at is {at!r}", where="mesh(at=...)", fix="give (angle in degrees, height in mm)")
    within("mesh", "angle_deg", at[0])
    within("mesh", "height_mm", at[1])
    return float(at[0]), float(at[1])


def thickness(value: float | str | None, name: str) -> Any:
    """The value in the form that the stage expects."""
    from limbcli.site_model.site_layers import thickness_of

    if isinstance(value, str):
        return thickness_of(value, name)
    return None if value is None else float(value)


def _seeds(seeds: Any) -> tuple[tuple[Literal["bone", "soft"], Point], ...]:
    """The seeds in the form that the stage expects; the stage checks the kinds.

    >>> _seeds([("bone", (1, -2.5, 30))])
    (('bone', (1.0, -2.5, 30.0)),)
    """
    try:
        found = []
        for kind, place in seeds:
            x, y, z = (float(each) for each in place)
            found.append((kind, (x, y, z)))
    except (TypeError, ValueError):
        what, fix = f"seeds is {seeds!r}", 'give a list such as [("bone", (12.0, 40.0, -60.0))]'
        raise CaseError(what, where="segment(seeds=...)", fix=fix) from None
    return tuple(found)
