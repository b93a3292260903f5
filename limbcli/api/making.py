"""synth and make_phantom: create cases whose truth is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from limbcli.api.base import Result
from limbcli.api.call import (
    CaseLike,
    Heard,
    PathLike,
    at_work,
    folder_of,
    foreseen,
    listening,
    names_of,
    records_call,
)
from limbcli.api.limits import one_of, tables, within
from limbcli.case import Case
from limbcli.case.toml_file import read_toml
from limbcli.mesh_bounds import ELEMENTS
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.stages.simulated_subjects.synth_options import SynthOptions


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


@records_call
def synth(
    case: CaseLike,
    out_case: PathLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    seed: int = 7,
    force: bool = False,
    c_kpa: float = 8.0,
    f_kappa: float = 80.0,
    m: float = 6.0,
    effects: str | Iterable[str] = (),
    noise: float = 1.0,
    step_n: float = 2.0,
    max_force_n: float = 12.0,
    max_strain: float = 0.45,
    element: Literal["tet10", "tet4"] | None = None,
    size_mm: float = 4.0,
    far_size_mm: float = 12.0,
    margin_mm: float | None = None,
    same_mesh: bool = False,
    contact_penalty: float | None = None,
    with_layers: bool = False,
    stretch_along: Mapping[str, float] | None = None,
    stretch_around: Mapping[str, float] | None = None,
    unloaded_stretch_along: float | None = None,
    unloaded_stretch_around: float | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> MadeCase:
    """Simulate measurements with known parameters on the geometry of a case, as a new case.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    out_case : the case folder to create; the truth is written to <out_case>.truth.toml beside it
    sites : name or names; None: all
    seed : of the measurement noise
    force : replace `out_case` if it was created by synth
    c_kpa, f_kappa, m : parameters of the tissue, kappa' = f_kappa c
    effects : effects to hide in the data, each "name" or "name=size", where size is the value of its first
        parameter
    noise : factor on the noise stated in the case; 0: no noise
    step_n, max_force_n : force step and largest force
    max_strain : largest depth over skin-bone distance
    element, size_mm, far_size_mm, margin_mm : mesh of the simulation (None: as in the case)
    same_mesh : simulate on the same mesh that is used for fitting
    contact_penalty : multiple of the skin's stiffness at rest; None: 20
    with_layers : also record the thickness of skin, fat and muscle, which at first touch is that of the
        geometry
    stretch_along, stretch_around : true stretches relative to unloaded tissue, by state, where the case does
        not give them
    unloaded_stretch_along, unloaded_stretch_around : stretch of unloaded tissue on the scale of the case

    Raises
    ------
    CaseError
        If `out_case` exists and `force` is not given, or an argument is invalid.
    MeshError, SolveError
        If a site cannot be meshed or simulated.
    """
    within(
        "synth", contact_penalty=contact_penalty, unloaded_stretch_along=unloaded_stretch_along,
        unloaded_stretch_around=unloaded_stretch_around,
    )  # fmt: skip
    tables("synth", {"bent": 0.8}, stretch_along=stretch_along, stretch_around=stretch_around)
    from limbcli.case.parts import Stretch
    from limbcli.stages import synth as stage
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.known_stretches import known_stretches

    hidden = tuple(hide(each) for each in names_of(effects or None, "effects") or ())
    stretches = known_stretches(
        stretch_along or {}, stretch_around or {}, Stretch(unloaded_stretch_along, unloaded_stretch_around)
    )
    plan = _plan(
        "synth", seed=seed, c_kpa=c_kpa, f_kappa=f_kappa, m=m, noise=noise, step_n=step_n,
        max_force_n=max_force_n, max_strain=max_strain, element=element, size_mm=size_mm,
        far_size_mm=far_size_mm, margin_mm=margin_mm, same_mesh=same_mesh, hidden=hidden,
        contact_penalty=contact_penalty, layers=with_layers, stretches=stretches,
    )  # fmt: skip
    with at_work(case, out, wait=wait, progress=progress) as work:
        found = stage.synth(
            work.case, out=work.out, out_case=folder_of(out_case, "out_case"), sites=names_of(sites),
            options=plan, force=force, progress=work.progress,
        )  # fmt: skip
    return MadeCase.of(found)


@records_call
def make_phantom(
    folder: PathLike,
    *,
    seed: int = 7,
    force: bool = False,
    subject: str = "phantom",
    sites: str | Iterable[str] | None = None,
    no_measurement: bool = False,
    c_kpa: float = 8.0,
    f_kappa: float = 80.0,
    m: float = 6.0,
    effects: str | Iterable[str] = (),
    noise: float = 1.0,
    step_n: float = 2.0,
    max_force_n: float = 12.0,
    max_strain: float = 0.45,
    element: Literal["tet10", "tet4"] | None = None,
    size_mm: float = 4.0,
    far_size_mm: float = 12.0,
    margin_mm: float | None = None,
    same_mesh: bool = False,
    progress: Heard = None,
) -> MadeCase:
    """Create a synthetic subject with known truth: MRI as DICOM, measurements, truth (`limbcli phantom`).

    Parameters
    ----------
    folder : the case folder to create; the truth is written to <folder>/truth
    seed : determines the subject
    force : replace the folder if it is a synthetic subject
    subject : its id
    sites : "p1" (at the back, by marker, across), "p2" (over the fibula, by position, along); None: p1
    no_measurement : geometry only, levels.csv stays empty
    progress : called with (kind, facts) at each event; None: no calls
    the others : as for `synth`; element None: tet10

    Raises
    ------
    CaseError
        If the folder exists and `force` is not given, or contains anything other than a synthetic subject.
    MeshError, SolveError
        If a site cannot be meshed or simulated.
    """
    from limbcli.stages import phantom as stage
    from limbcli.stages.simulated_subjects.hidden_effects import hide

    hidden = tuple(hide(each) for each in names_of(effects or None, "effects") or ())
    plan = _plan(
        "phantom", seed=seed, c_kpa=c_kpa, f_kappa=f_kappa, m=m, noise=noise, step_n=step_n,
        max_force_n=max_force_n, max_strain=max_strain, element=element, size_mm=size_mm,
        far_size_mm=far_size_mm, margin_mm=margin_mm, same_mesh=same_mesh, hidden=hidden,
    )  # fmt: skip
    if no_measurement:
        stage.refuse_unheard(plan)
    options = stage.PhantomOptions(
        seed=seed, subject_id=subject, site_names=tuple(names_of(sites) or stage.USUAL_SITES),
        element=element or "tet10", synth=None if no_measurement else plan,
    )  # fmt: skip
    with foreseen():
        target = folder_of(folder, "folder")
        found = stage.phantom(target, options=options, force=force, progress=listening(progress))
    return MadeCase.of(found)


def _plan(
    function: str, *, seed: int, c_kpa: float, f_kappa: float, m: float, noise: float, step_n: float,
    max_force_n: float, max_strain: float, element: str | None, size_mm: float, far_size_mm: float,
    margin_mm: float | None, same_mesh: bool, **others: Any,
) -> SynthOptions:  # fmt: skip
    """Options of the simulation, after all numbers have been checked."""
    within(
        function, seed=seed, c_kpa=c_kpa, f_kappa=f_kappa, m=m, noise=noise, step_n=step_n,
        max_force_n=max_force_n, max_strain=max_strain, size_mm=size_mm, far_size_mm=far_size_mm,
        margin_mm=margin_mm,
    )  # fmt: skip
    one_of(function, ELEMENTS, element=element)
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.simulated_subjects.synth_options import LoadingProtocol, SynthOptions

    return SynthOptions(
        tissue=KnownTissue(c_kpa=c_kpa, f_kappa=f_kappa, m=m), seed=seed, noise=noise, element=element,
        size=size_mm, far_size=far_size_mm, margin=margin_mm, same_mesh=same_mesh,
        protocol=LoadingProtocol(step=step_n, max_force=max_force_n, max_strain=max_strain), **others,
    )  # fmt: skip
