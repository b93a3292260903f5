"""The stiffness of a whole limb as a field, from the sites at which it was measured.

`limb_coordinates` prepares skin, bones and axis; `stiffness_field` conditions the field on `SiteReading`s and
`MapReading`s; `StiffnessField.at` gives c with its interval and label at any points, `Draws` joint draws,
`held_out` the test of leaving one site out. Nothing here knows of meshes, cases or files of results.
"""

from limbcli.stiffness_field.coordinates import LimbCoordinates, limb_coordinates
from limbcli.stiffness_field.draws import Draws, write_draws
from limbcli.stiffness_field.field import (
    LABELS,
    PRIORS,
    FieldPrior,
    HypothesisGrid,
    PointValues,
    StiffnessField,
    stiffness_field,
)
from limbcli.stiffness_field.forces import ForceReading
from limbcli.stiffness_field.held_out import contradictions, held_out
from limbcli.stiffness_field.likelihood import Interval
from limbcli.stiffness_field.readings import PARAMETERS, MapReading, SiteReading, map_reading, region_below

__all__ = [
    "LABELS", "PARAMETERS", "PRIORS", "Draws", "FieldPrior", "ForceReading", "HypothesisGrid", "Interval",
    "LimbCoordinates", "MapReading", "PointValues", "SiteReading", "StiffnessField", "contradictions",
    "held_out", "limb_coordinates", "map_reading", "region_below", "stiffness_field", "write_draws",
]  # fmt: skip
