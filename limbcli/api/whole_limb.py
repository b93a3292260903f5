"""limb: from the surfaces of a limb to the model of the whole limb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from limbcli.api.base import Result
from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path, records_call
from limbcli.api.limits import one_of, within
from limbcli.case import Case
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel


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
    c_kpa, f_kappa, m : of the tissue's law where no element has a value of its own
    bones : the rigid bodies
    patches : named patches of the skin; those that cannot be placed are in `missing`, with the reason
    """

    stage: ClassVar[str] = "limb"
    element: str
    n_cells: int
    n_nodes: int
    size_mm: float
    min_angle_deg: float
    volume_cm3: float
    c_kpa: float
    f_kappa: float
    m: float
    bones: tuple[str, ...]
    patches: tuple[str, ...]
    missing: dict[str, str]

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data, law = found.data, found.data["stiffness"]
        patches = (name.removeprefix("patch_") for name in data["surfaces"] if name.startswith("patch_"))
        return cls(
            found, data["element"], data["n_cells"], data["n_nodes"], data["size_mm"],
            data["quality"]["min_angle_deg"], data["volume_cm3"], law["c_kpa"], law["f_kappa"], law["m"],
            tuple(data["bones"]), tuple(patches), dict(data["missing_parts"]),
        )  # fmt: skip

    def rows(self) -> list[dict[str, Any]]:
        left_out = ("stage_result", "bones", "patches", "missing")
        names = [each.name for each in fields(self) if each.name not in left_out]
        return [self._named({name: getattr(self, name) for name in names})]

    def model(self) -> LimbModel:
        """The model at rest, with its named surfaces and node sets."""
        from limbcli.model_io import load_model

        return load_model(self.files["model"])


@records_call
def limb(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    element: Literal["tet10", "tet4"] | None = None,
    nodes: int = 40_000,
    site_size_mm: float | None = None,
    cut_mm: float | None = None,
    distal_cut: bool = False,
    skin_mm: float | Literal["mri"] | None = None,
    fat_mm: float | Literal["mri"] | None = None,
    c_kpa: float | None = None,
    draws: Sequence[int] = (),
    templates: PathLike | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> LimbResult:
    """Build the finite-element model of the whole limb, with named parts. Requires `segment`.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    element : None: as in the case
    nodes : about this number of nodes, 3000 to 400000
    site_size_mm : edge length round the sites, such as 3 to set a probe there; None: as elsewhere
    cut_mm : height of the proximal cut above the distal end; None: where the images end
    distal_cut : accept a limb whose distal end was not imaged
    skin_mm, fat_mm : thickness of a layer all over the limb, 0: no layer, "mri": as found by `segment`; None:
        the mean of the case's sites
    c_kpa : c = 2 mu of the tissue; None: the field through the fitted or diagnosed sites, else from SWE at
        rest
    draws : numbers (0 to 49) of draws of the field whose models are written too
    templates : a folder of Jinja templates that take precedence over the built-in ones

    Raises
    ------
    CaseError
        If `segment` has not been run since its inputs changed, the limb cannot be meshed as it is (cut at
        both ends, no bones, a bone outside the skin), its stiffness is unknown, or an argument is invalid.
    MeshError
        If no volume mesh of sufficient quality could be generated.

    Source: docs/limb.md has the definition of every named part.
    """
    within("limb", nodes=nodes, cut_mm=cut_mm, site_size_mm=site_size_mm, c_kpa=c_kpa)
    one_of("limb", ("tet10", "tet4"), element=element)
    from limbcli.api.geometry import thickness_argument
    from limbcli.stages import limb as stage

    options = stage.LimbOptions(
        element, nodes, cut_mm, distal_cut, thickness_argument("limb", "skin_mm", skin_mm),
        thickness_argument("limb", "fat_mm", fat_mm), c_kpa, site_size_mm,
        tuple(draws),
    )  # fmt: skip
    with at_work(case, out, wait=wait, progress=progress, opening=Case.open_images) as work:
        found = stage.limb(
            work.case, out=work.out, options=options, templates=maybe_path(templates, "templates"),
            progress=work.progress,
        )  # fmt: skip
    return LimbResult.of(found)
