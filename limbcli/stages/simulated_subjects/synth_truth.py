"""The truth of simulated measurements of a site or of each of its states: truth.toml, and a summary line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from limbcli.phantom.case_folder import NoiseLaw
from limbcli.phantom.protocol import TrueLevels
from limbcli.phantom.simulated_readings import Readings
from limbcli.stages.simulated_subjects.known_stretches import TrueState
from limbcli.stages.simulated_subjects.synth_case import noise_table
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.version import __version__


@dataclass(frozen=True, eq=False, kw_only=True)
class SyntheticSite:
    """Truth and readings of one site, or of one of its states if it has any."""

    site: str
    true: TrueLevels
    readings: Readings
    law: NoiseLaw
    facts: Mapping[str, Any]
    state: TrueState | None = None

    @property
    def label(self) -> str:
        """Relative path of its files."""
        return self.site if self.state is None else f"{self.site}/{self.state.name}"


def truth_table(measured: list[SyntheticSite], options: SynthOptions) -> dict[str, Any]:
    """The content of truth.toml."""
    return {
        "made_by": f"limbcli {__version__}",
        "measurement_seed": options.seed,
        "tissue": vars(options.tissue),
        **({} if options.contact_penalty is None else {"contact_penalty": options.contact_penalty}),
        "hidden": [each.facts() for each in options.hidden],
        "site": [
            _true_site([each for each in measured if each.site == name], options)
            for name in dict.fromkeys(each.site for each in measured)
        ],
    }


def _true_site(measured: list[SyntheticSite], options: SynthOptions) -> dict[str, Any]:
    """The truth of a site: of its only measurement, or of that in each state."""
    first = measured[0]
    noise = {"noise": noise_table(first.law, layers=first.true.borders is not None)}
    if first.state is None:
        return {"name": first.site, **first.facts, **_true_readings(first), **noise}
    given = vars(options.stretches.unloaded).items()
    unloaded = {f"unloaded_stretch_{way}": value for way, value in given if value is not None}
    states = [
        {
            "name": each.state.name,
            "stretch_along": each.state.along,
            "stretch_around": each.state.around,
            **_true_readings(each),
        }
        for each in measured
        if each.state is not None
    ]
    return {"name": first.site, **first.facts, **unloaded, **noise, "state": states}


def _true_readings(each: SyntheticSite) -> dict[str, Any]:
    """True values at every level; indices (from 0) of the levels without a row in levels.csv."""
    left_out = {"levels_not_read": list(each.readings.left_out)} if each.readings.left_out else {}
    return {
        **left_out,
        "skin_bone_mm": float("nan") if each.true.skin_bone is None else each.true.skin_bone,
        "force_n": _rounded(each.true.force),
        "depth_mm": _rounded(each.true.depth),
        "swe_mean_m_per_s": [round(float(m.speed_m_per_s.mean()), 5) for m in each.true.maps],
        **_true_layers(each),
    }


def _true_layers(each: SyntheticSite) -> dict[str, list[float]]:
    """Thickness of skin and fat (mm) at every level, where they were followed."""
    if each.true.borders is None:
        return {}
    upper = np.diff(each.true.borders, axis=1, prepend=0.0)
    return {"skin_mm": _rounded(upper[:, 0]), "fat_mm": _rounded(upper[:, 1])}


def _rounded(values: Any) -> list[float]:
    return [round(float(each), 6) for each in values]


def summary_of(each: SyntheticSite) -> str:
    """The summary line of a site or state."""
    true, n_read = each.true, len(each.readings.force)
    speeds = [float(m.speed_m_per_s.mean()) for m in true.maps]
    return (
        f"{each.label}: {n_read} levels to {true.force[-1]:g} N at {true.depth[-1]:.1f} mm; "
        f"SWE {speeds[0]:.2f} to {speeds[-1]:.2f} m/s; {each.facts['n_elements']} {each.facts['element']}"
    )
