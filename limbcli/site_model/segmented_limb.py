"""What `segment` left of a limb: its surfaces, where a site lies on them, and the inputs of a site's mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from limbcli.case import Case, Site
from limbcli.errors import CaseError
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.provenance.requested_options import Requested
from limbcli.results import StageResult, StageWriter


def named_surfaces(segmented: StageResult) -> tuple[Triangles, dict[str, Triangles]]:
    """The skin, and the bones by name, written by `segment`."""
    names = sorted(name for name in segmented.files if name.startswith("bone_"))
    bones = {name: read_surface(segmented.path(name)) for name in names}
    return read_surface(segmented.folder / "skin.ply"), bones


def read_limb(segmented: StageResult) -> Limb:
    """The surfaces written by `segment`, repaired."""
    skin, bones = named_surfaces(segmented)
    return mend(skin, list(bones.values()), where=str(segmented.folder))


def note_segmented(
    segmented: StageResult, writer: StageWriter, *, layered: Sequence[str], markers: bool
) -> None:
    """Record what is used of a result of `segment`: its surfaces, layers at sites, and whether markers."""
    surfaces = [name for name, path in segmented.files.items() if path.endswith(".ply")]
    data = [f"layers/{name}" for name in layered] + (["markers"] if markers else [])
    writer.used_result(segmented, files=surfaces, data=data)


def site_position(site: Site, segmented: StageResult) -> tuple[float, float, float]:
    """Position of a site (LPS, mm): as given, or that of its marker.

    Raises CaseError if the marker was not found in the images.
    """
    if site.position is not None:
        return site.position
    markers = {each["number"]: each["position_mm"] for each in segmented.data.get("markers", [])}
    if site.marker not in markers:
        known = ", ".join(map(str, sorted(markers))) or "none"
        raise CaseError(
            f"marker {site.marker} was not found (markers in the images: {known})",
            where=f"site {site.name}",
            fix="see the contact sheet of `limbcli segment`, or give position_mm instead of marker",
        )
    x, y, z = markers[site.marker]
    return float(x), float(y), float(z)


@dataclass(frozen=True, eq=False)
class MeshInputs:
    """of_case : what was and will be asked of the case for one site; requested : the options given
    layered : whether the site's layers have the thickness found by `segment`
    """

    of_case: CaseInputs
    segmented: StageResult
    requested: Requested
    layered: bool = False

    @property
    def case(self) -> Case:
        return self.of_case.case

    def note(self, writer: StageWriter, site: Site) -> None:
        """Record the inputs of one site's mesh."""
        self.of_case.into(writer)
        layered = [site.name] if self.layered else []
        note_segmented(self.segmented, writer, layered=layered, markers=site.position is None)
