"""Joint preparation of all measurements of one place, on the limb whose bones agree with the readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from limbcli.case import Case, Site
from limbcli.diagnostics import thresholds
from limbcli.errors import LimbError
from limbcli.progress import Progress
from limbcli.results import read_result, stage_folder
from limbcli.stages.diagnosis.bones.bone_hypotheses import OtherBones, questions
from limbcli.stages.diagnosis.bones.evidence import Evidence, compared, is_poor_fit
from limbcli.stages.diagnosis.bones.limb_with import limb_with
from limbcli.stages.diagnosis.data.noise import IN_MAPS
from limbcli.stages.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.stages.diagnosis.prepare import STAGE, Prepared


@dataclass(eq=False)
class Place:
    """The prepared measurements of one place on one limb.

    prepared : the sites; forward_model : of all of them jointly
    out : folder with `segment` and `mesh` of the limb; bones : settled evidence on other bones
    rivals : limbs with other bones that the readings support, by decreasing gain after `better_than`
    given_up : messages on limbs that were rejected on their force curves alone
    problems : messages on limbs that could not be tried
    """

    prepared: list[Prepared]
    forward_model: SiteForwardModel
    out: Path
    bones: list[Evidence] = field(default_factory=list)
    rivals: list[tuple[Evidence, Place]] = field(default_factory=list)
    given_up: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def close(self) -> None:
        for each in self.prepared:
            each.close()
        for _, rival in self.rivals:
            rival.close()

    def instead_of(self, other: Place, found: Evidence) -> Place:
        """Replace `other` by this place: take over its notes, and close it."""
        self.bones = [*other.bones, replace(found, stand="taken")]
        self.problems, self.given_up = other.problems, other.given_up
        other.rivals = [(e, rival) for e, rival in other.rivals if rival is not self]
        other.close()
        return self

    def better_than(self, effect_gain: float, *, is_named: bool) -> Place:
        """This place, or a rival that the readings support even against the best effect.

        effect_gain : reduction of chi2 by the best single effect on this limb. Rivals that it beats are
        settled, but not a limb whose misplaced bones were put back, unless the effect is named (is_named):
        effects that cannot be told apart may be those of bones that are known to be wrong
        """
        rivals = sorted(self.rivals, key=lambda each: -each[0].gain)
        if rivals and rivals[0][0].beats(effect_gain):
            return rivals[0][1].instead_of(self, rivals[0][0])
        self.rivals = []
        for found, rival in rivals:
            stays = found.against(effect_gain)
            if stays.stand == "open" or (found.other.is_repair and not is_named):
                self.rivals.append((stays, rival))
            else:
                self.settled(stays, rival)
        return self

    def settled(self, found: Evidence, rival: Place) -> None:
        """Record the final evidence on a rival, and close it."""
        self.bones.append(found)
        self.rivals = [each for each in self.rivals if each[1] is not rival]
        rival.close()


@dataclass(eq=False)
class PlaceMaker:
    """Prepares a place on the limb of a folder.

    out : the case's output folder; prepared_in : prepares all sites on the limb of a folder
    misfit_in : depth misfit in mm of that limb, from its first force curves
    """

    case: Case
    sites: Sequence[Site]
    out: Path
    prepared_in: Callable[[Path], list[Prepared]]
    misfit_in: Callable[[Path], float]
    progress: Progress

    def best(self) -> Place:
        """The place on the limb as segmented, or on one with other bones if the evidence for it is decisive.

        Limbs with weaker evidence become its `rivals`.

        Raises
        ------
        LimbError
            If the limb as segmented cannot be meshed, simulated or fitted.
        """
        place = self._in(self.out)
        try:
            for other in self._questions(place):
                place = self._compared(place, other)
        except BaseException:
            place.close()
            raise
        return place

    def _in(self, folder: Path) -> Place:
        prepared = self.prepared_in(folder)
        place = Place(prepared, SiteForwardModel([each.curves for each in prepared]), folder)
        try:
            place.forward_model.settle_noise()
        except BaseException:
            place.close()
            raise
        return place

    def _questions(self, place: Place) -> list[OtherBones]:
        """Limbs with other bones that are worth a simulation.

        None if the fit without effects leaves no significant residual and the estimated model error in maps
        is not unusually large.
        """
        if not (stage_folder(self.out, "segment") / "segment.json").is_file():
            return []  # no surfaces: the site's own mesh is the working mesh
        try:
            found = questions(self.case, self.sites, read_result(self.out, "segment"))
        except LimbError as error:
            place.problems.append(f"alternative bone positions were not tested: {error.what}")
            return []
        model = place.forward_model
        absorbed = model.shares.get(IN_MAPS, 0.0) > thresholds.BONES_ABSORBED
        if found and not absorbed and not is_poor_fit(model, model.fit((), {}), thresholds.BONES_LOOKED_AT):
            return []
        return found

    def _compared(self, place: Place, other: OtherBones) -> Place:
        """Compare this place with the same place on the limb with other bones; returns the place to continue
        with.

        The other place replaces this one if the evidence is decisive, is kept as a rival if the readings
        support it, and is closed otherwise.
        """
        self.progress.event("note", text=f"the limb {other.words}")
        try:
            folder = limb_with(
                other, self.case, self.sites, out=self.out, work=self.out / STAGE, progress=self.progress
            )
            ours, theirs = self.misfit_in(self.out), self.misfit_in(folder)
            if theirs > thresholds.BONES_HOPELESS * max(ours, _noise_of_depth(self.sites)):
                place.given_up.append(
                    f"Tried {other.words}: its force curves differ from the depths by "
                    f"{theirs:.1f} mm, those of the limb as segmented by {ours:.1f}; not considered further."
                )
                return place
            tried = self._in(folder)
        except LimbError as error:
            place.problems.append(f"the limb {other.words} was not tried: {error.what}")
            return place
        here, there = place.forward_model, tried.forward_model
        try:
            found = compared(other, here, here.fit((), {}), there, there.fit((), {}))
        except LimbError as error:
            tried.close()
            place.problems.append(f"the limb {other.words} was not tried: {error.what}")
            return place
        if found.is_decisive:
            return tried.instead_of(place, found)
        if found.speaks_for_it:
            place.rivals.append((found, tried))
        else:
            tried.close()
            place.bones.append(found)
        return place


def _noise_of_depth(sites: Sequence[Site]) -> float:
    """Largest depth noise of the sites, in mm."""
    return max(each.noise.depth for each in sites)
