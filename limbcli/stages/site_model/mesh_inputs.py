"""The inputs of a mesh: surfaces, site, probe, and the case's values of options that were not given."""

from __future__ import annotations

from dataclasses import dataclass

from limbcli.case import Case, Site
from limbcli.results import StageResult, StageWriter
from limbcli.stages.provenance.chain_inputs import note_case
from limbcli.stages.provenance.requested_options import Requested


@dataclass(frozen=True, eq=False)
class MeshInputs:
    """layered : sites whose layers have the thickness found by `segment`; requested : the options given"""

    case: Case
    segmented: StageResult
    requested: Requested
    layered: tuple[str, ...] = ()

    def note(self, writer: StageWriter, site: Site) -> None:
        """Record the inputs of one site's mesh."""
        of_model = [f"model/{name}" for name in ("margin", "element") if name not in self.requested]
        own = ["long_axis", "layers"] + (["place"] if "place" not in self.requested else [])
        note_case(writer, self.case, ["probe", *of_model], site=site, own=own)
        surfaces = [name for name, path in self.segmented.files.items() if path.endswith(".ply")]
        seen = [f"layers/{site.name}"] if site.name in self.layered else []
        markers = ["markers"] if site.position is None else []
        writer.used_result(self.segmented, files=surfaces, data=[*seen, *markers])
