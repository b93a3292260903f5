"""The inputs of a mesh: the case's values, and the surfaces and places found by `segment`."""

from __future__ import annotations

from dataclasses import dataclass

from limbcli.case import Case, Site
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.provenance.requested_options import Requested
from limbcli.results import StageResult, StageWriter
from limbcli.site_model.segmented_limb import note_segmented


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
