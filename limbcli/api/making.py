"""synth and make_phantom: create cases whose truth is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, folder_of, foreseen, listening, names_of
from limbcli.api.stage_result import Result, one
from limbcli.numbers.mesh_bounds import FAR_SIZE_MM, SIZE_MM
from limbcli.options import CASE, MARGIN, OUT, PROGRESS, SITES, WAIT, Option
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.case import Case

SIMULATED_C = Option("c = 2 mu of the known tissue.", (0.1, 200.0))
SIMULATED_F = Option("kappa' / c of the known tissue.", (0.01, 1000.0))
SIMULATED_M = Option("Exponent m of the known tissue's law.", (1.0, 100.0))
EFFECTS = Option(
    "Hide this effect in the data (may be repeated). SIZE is the value of its first parameter, as in the "
    "list of effects, such as skin-layer=2.3; default: its typical one.",
    flag="--effect", metavar="ID[=SIZE]", kind=list[str],
    python='Effects to hide in the data, each "name" or "name=size", where size is the value of its first '
    "parameter; default: its typical one.",
)  # fmt: skip
NOISE = Option("Noise of the readings, as a multiple of the stated noise; 0: none.", (0.0, 20.0))
STEP = Option("Force step, N.", (0.1, 20.0))
MAX_FORCE = Option("Largest force, N.", (1.0, 80.0))
MAX_STRAIN = Option("Largest depth, divided by the skin-bone distance.", (0.05, 0.6))
SIMULATED_ELEMENT = Option("Element type of the simulation; default: the case's.", metavar="tet10|tet4")
SIMULATED_SIZE = Option("Edge length under the probe in the mesh of the simulation, mm.", SIZE_MM)
SIMULATED_FAR_SIZE = Option("Edge length far from the probe in that mesh, mm.", FAR_SIZE_MM)
SAME_MESH = Option("Simulate on the same mesh on which a fit works.")
_STRETCHES = {"metavar": "STATE=STRETCH", "kind": list[str], "example": {"bent": 0.8}}


@dataclass(frozen=True, eq=False)
class MadeCase(Result):
    """A case with simulated measurements. `table()` has one row of true values per level of each site.

    For a site with states there is one row per level of each state, named by the column `state`.

    Attributes
    ----------
    case : the new case, opened
    truth : its true values, as in its TOML file (which no stage reads)
    """

    case: Case
    truth: dict[str, Any]

    @classmethod
    def of(cls, found: StageResult) -> Self:
        from limbcli.case import Case
        from limbcli.case.toml_file import read_toml

        path = found.path("truth") if "truth" in found.files else Path(found.data["truth"])
        truth = read_toml(path)
        return cls(found, Case.open(found.folder.absolute()), truth)

    def rows(self) -> list[dict[str, Any]]:
        names = ("force_n", "depth_mm", "swe_mean_m_per_s")
        measured = [
            ({"site": site["name"], **({"state": one["name"]} if "state" in site else {})}, one)
            for site in self.truth.get("site", ())
            for one in site.get("state", [site])
        ]
        return [
            self._named({**place, **dict(zip(names, level, strict=True))})
            for place, one in measured
            for level in zip(*(one[name] for name in names), strict=True)
        ]


@one(MadeCase)
def synth(
    case: Annotated[CaseLike, CASE],
    out_case: Annotated[
        PathLike,
        Option(
            "Case folder to create.",
            flag="--out-case",
            metavar="DIR",
            kind=Path,
            python="Case folder to create; the truth is written to <out_case>.truth.toml beside it.",
        ),
    ],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    seed: Annotated[int, Option("Random seed of the measurement noise.", (0, None))] = 7,
    force: Annotated[
        bool, Option("Replace DIR if synth made it.", python="Replace `out_case` if synth made it.")
    ] = False,
    c_kpa: Annotated[float, SIMULATED_C] = 8.0,
    f_kappa: Annotated[float, SIMULATED_F] = 80.0,
    m: Annotated[float, SIMULATED_M] = 6.0,
    effects: Annotated[str | Iterable[str], EFFECTS] = (),
    noise: Annotated[float, NOISE] = 1.0,
    step_n: Annotated[float, STEP] = 2.0,
    max_force_n: Annotated[float, MAX_FORCE] = 12.0,
    max_strain: Annotated[float, MAX_STRAIN] = 0.45,
    element: Annotated[Literal["tet10", "tet4"] | None, SIMULATED_ELEMENT] = None,
    size_mm: Annotated[float, SIMULATED_SIZE] = 4.0,
    far_size_mm: Annotated[float, SIMULATED_FAR_SIZE] = 12.0,
    margin_mm: Annotated[float | None, MARGIN] = None,
    same_mesh: Annotated[bool, SAME_MESH] = False,
    with_layers: Annotated[
        bool, Option("Also simulate readings of the skin, fat and muscle thickness, as in the geometry.")
    ] = False,
    contact_penalty: Annotated[
        float | None,
        Option(
            "Contact penalty, as a multiple of the skin's stiffness at rest; default: 20. With a higher one "
            "the probe sinks in less.",
            (1.0, 1000.0),
        ),
    ] = None,
    stretch_along: Annotated[
        Mapping[str, float] | None,
        Option(
            "Stretch, relative to unloaded tissue, of a state whose stretch the case does not give (may be "
            "repeated).",
            **_STRETCHES,
        ),
    ] = None,
    stretch_around: Annotated[
        Mapping[str, float] | None, Option("The same around the limb.", **_STRETCHES)
    ] = None,
    unloaded_stretch_along: Annotated[
        float | None,
        Option("Stretch, on the scale of the case, at which the tissue is unloaded.", (0.5, 2.0)),
    ] = None,
    unloaded_stretch_around: Annotated[float | None, Option("The same around the limb.", (0.5, 2.0))] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Simulate measurements with known parameters on the geometry of a case, as a new case.

    Raises
    ------
    CaseError
        If `out_case` exists and `force` is not given, or an argument is invalid.
    MeshError, SolveError
        If a site cannot be meshed or simulated.
    """
    from limbcli.case.parts import Stretch
    from limbcli.stages import synth as stage
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.simulated_subjects.known_stretches import known_stretches
    from limbcli.stages.simulated_subjects.synth_options import LoadingProtocol, SynthOptions

    hidden = tuple(hide(each) for each in names_of(effects or None, "effects") or ())
    stretches = known_stretches(
        stretch_along or {}, stretch_around or {}, Stretch(unloaded_stretch_along, unloaded_stretch_around)
    )
    plan = SynthOptions(
        tissue=KnownTissue(c_kpa, f_kappa, m), protocol=LoadingProtocol(step_n, max_force_n, max_strain),
        seed=seed, noise=noise, element=element, size=size_mm, far_size=far_size_mm, margin=margin_mm,
        same_mesh=same_mesh, hidden=hidden, contact_penalty=contact_penalty, layers=with_layers,
        stretches=stretches,
    )  # fmt: skip
    with at_work(case, out, wait=wait, progress=progress) as work:
        return work.run(
            stage.synth, out_case=folder_of(out_case, "out_case"), sites=sites, options=plan, force=force,
        )  # fmt: skip


@one(MadeCase)
def make_phantom(
    folder: Annotated[
        PathLike,
        Option(
            "Case folder to create.",
            metavar="DIR",
            kind=Path,
            python="Case folder to create; the truth is written to <folder>/truth.",
        ),
    ],
    *,
    seed: Annotated[int, Option("Random seed; another seed gives another subject.", (0, None))] = 7,
    force: Annotated[bool, Option("Replace DIR if it is a synthetic subject.")] = False,
    subject: Annotated[str, Option("The subject's id.", flag="--id", metavar="NAME")] = "phantom",
    sites: Annotated[
        str | Iterable[str] | None,
        Option(
            "p1: on the back of the limb, given by a marker, probe across; p2: over the fibula, given by a "
            "position, probe along. May be repeated; default: p1.",
            flag="--site",
            short="-s",
            metavar="NAME",
            kind=list[str],
        ),
    ] = None,
    no_measurement: Annotated[bool, Option("Geometry only: levels.csv stays empty.")] = False,
    c_kpa: Annotated[float, SIMULATED_C] = 8.0,
    f_kappa: Annotated[float, SIMULATED_F] = 80.0,
    m: Annotated[float, SIMULATED_M] = 6.0,
    effects: Annotated[str | Iterable[str], EFFECTS] = (),
    noise: Annotated[float, NOISE] = 1.0,
    step_n: Annotated[float, STEP] = 2.0,
    max_force_n: Annotated[float, MAX_FORCE] = 12.0,
    max_strain: Annotated[float, MAX_STRAIN] = 0.45,
    element: Annotated[Literal["tet10", "tet4"] | None, SIMULATED_ELEMENT] = None,
    size_mm: Annotated[float, SIMULATED_SIZE] = 4.0,
    far_size_mm: Annotated[float, SIMULATED_FAR_SIZE] = 12.0,
    margin_mm: Annotated[float | None, MARGIN] = None,
    same_mesh: Annotated[bool, SAME_MESH] = False,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Create a synthetic subject with known truth: MRI as DICOM, measurements, truth (`limbcli phantom`).

    Raises
    ------
    CaseError
        If the folder exists and `force` is not given, or contains anything other than a synthetic subject.
    MeshError, SolveError
        If a site cannot be meshed or simulated.
    """
    from limbcli.stages import phantom as stage
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.simulated_subjects.synth_options import LoadingProtocol, SynthOptions

    hidden = tuple(hide(each) for each in names_of(effects or None, "effects") or ())
    plan = SynthOptions(
        tissue=KnownTissue(c_kpa, f_kappa, m), protocol=LoadingProtocol(step_n, max_force_n, max_strain),
        seed=seed, noise=noise, element=element, size=size_mm, far_size=far_size_mm, margin=margin_mm,
        same_mesh=same_mesh, hidden=hidden,
    )  # fmt: skip
    if no_measurement:
        stage.refuse_unheard(plan)
    options = stage.PhantomOptions(
        seed=seed, subject_id=subject, site_names=tuple(names_of(sites) or stage.USUAL_SITES),
        element=element or "tet10", synth=None if no_measurement else plan,
    )  # fmt: skip
    with foreseen():
        target = folder_of(folder, "folder")
        return stage.phantom(target, options=options, force=force, progress=listening(progress))
