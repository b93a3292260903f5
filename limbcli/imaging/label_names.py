"""What a segment of a label map is, by its name or by the number that a known program gives it."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE

_FILE = Path(__file__).with_name("label_presets.csv")
OUTSIDE = 0
# Words that identify the kinds of segment: whole words, or prefixes where marked with a star. Names of bones
# are whole words: "tibialis" is not "tibia".
_MARKER = ("marker*", "capsule*", "fiducial*", "pinpoint*")
_IN_FLESH = (  # takes precedence over bones, after which many muscles are named
    "musc*", "muskel*", "tibialis", "fibularis", "peroneus", "peroneal", "achilles", "gastrocnemi*",
    "soleus", "plantaris", "popliteus", "flexor*", "extensor*", "femoris", "vastus", "quadriceps",
    "biceps", "triceps", "hamstring*", "sartorius", "gracilis", "adductor*", "abductor*", "tendon*",
    "ligament*", "nerve*", "arter*", "vein*", "vena*", "vessel*", "compartment*", "glut*",
    "semimembranosus", "semitendinosus", "semispinalis", "tensor", "fascia", "fasciae", "iliotibial",
    "pectineus", "piriformis", "obturator*", "gemell*", "quadratus", "psoas", "iliopsoas", "iliacus",
    "cartilage*", "menisc*", "multifidus", "erector", "autochthon", "latissimus", "trapezius", "deltoid*",
    "rhomboid*", "supraspinatus", "infraspinatus", "subscapularis", "teres", "pectoralis", "serratus",
    "levator", "longus", "brevis", "brachialis", "brachioradialis", "coracobrachial*", "anconeus",
    "supinator", "pronator*", "interosse*", "lumbrical*",
)  # fmt: skip
# bones that keep their own names, by the words for them
_NAMED_BONE = {
    "tibia": "tibia", "tibiae": "tibia", "tibias": "tibia", "fibula": "fibula", "fibulae": "fibula",
    "fibulas": "fibula", "femur": "femur", "femurs": "femur", "femora": "femur", "patella": "patella",
    "patellae": "patella", "patellas": "patella", "talus": "talus", "calcaneus": "calcaneus",
    "humerus": "humerus", "radius": "radius", "ulna": "ulna",
}  # fmt: skip
_BONE = (
    *_NAMED_BONE, "bone*", "knochen*", "cortex", "cortical", "marrow", "tarsal*", "metatarsal*",
    "carpal*", "metacarpal*", "phalan*", "navicular*", "cuboid", "cuneiform*", "sesamoid*", "hip", "hips",
    "pelvis", "ilium", "sacrum", "scapula", "clavicula", "clavicle", "rib", "ribs", "sternum", "skull",
    "vertebra", "vertebrae",
)  # fmt: skip
_FAT = ("fat", "fatty", "adipose", "subcut*", "sat", "imat")
_SOFT = ("soft*", "skin*", "flesh*")
_ANY_TISSUE = ("tissue*", "limb*", "leg*", "stump*", "body*")  # soft tissue, if no other kind is named
# what follows such a word is not in the segment
_WITHOUT = ("without", "no", "not", "non", "excluding", "except", "minus", "ohne")
_IGNORED = ("ignore", "ignored", "background", "outside", "air", "exterior", "unlabeled", "unlabelled")
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")  # "Tibia_left", "tibiaLeft" and "TIBIA2" hold "tibia"
WORDS = "soft tissue, skin, muscle, fat, bone, tibia, fibula, femur, patella, marker or ignore"


@dataclass(frozen=True)
class Meaning:
    """What a segment is.

    label : OUTSIDE, SOFT_TISSUE, BONE, MARKER or FAT
    bone : name of a bone that keeps it ("tibia"), else empty
    up_to_skin : whether the segment extends to the skin, as "skin" and "soft tissue" do; "muscle" does not
    """

    label: int
    bone: str = ""
    up_to_skin: bool = False

    @property
    def words(self) -> str:
        """
        >>> Meaning(BONE, "tibia").words, Meaning(OUTSIDE).words, Meaning(SOFT_TISSUE).words
        ('bone (tibia)', 'ignored', 'soft tissue')
        """
        kind = {OUTSIDE: "ignored", SOFT_TISSUE: "soft tissue", BONE: "bone", MARKER: "marker", FAT: "fat"}[
            self.label
        ]
        return f"{kind} ({self.bone})" if self.bone else kind


OURS = {
    0: Meaning(OUTSIDE),
    SOFT_TISSUE: Meaning(SOFT_TISSUE, up_to_skin=True),
    BONE: Meaning(BONE),
    MARKER: Meaning(MARKER),
    FAT: Meaning(FAT, up_to_skin=True),
}


def meaning_of(name: str) -> Meaning | None:
    """What a segment of this name is; None if the name refers to nothing known, or to several kinds.

    >>> meaning_of("Fibula left"), meaning_of("subcutaneous fat").label, meaning_of("Tibialis anterior").label
    (Meaning(label=2, bone='fibula', up_to_skin=False), 4, 1)
    >>> meaning_of("soft tissue without bone").label, meaning_of("Segment_1"), meaning_of("bone and fat")
    (1, None, None)
    >>> meaning_of("tibia and fibula"), meaning_of("liver")
    (Meaning(label=2, bone='', up_to_skin=False), Meaning(label=0, bone='', up_to_skin=False))
    """
    if name.strip().lower() in _IGNORED:
        return Meaning(OUTSIDE)
    kind = _known_names().get(_plain(name))
    if kind is not None and kind != name:
        return Meaning(BONE, _own_name(_words(name))) if kind == "bone" else meaning_of(kind)
    words = _words(name)
    if _names_any(words, _MARKER):
        return Meaning(MARKER)
    in_flesh, soft = _names_any(words, _IN_FLESH), _names_any(words, _SOFT)
    kinds = {SOFT_TISSUE} if in_flesh or soft else set()
    if _names_any(words, _BONE) and not in_flesh:
        kinds.add(BONE)
    if _names_any(words, _FAT):
        kinds.add(FAT)
    if not kinds and _names_any(words, _ANY_TISSUE):
        return Meaning(SOFT_TISSUE, up_to_skin=True)
    if len(kinds) != 1:
        return None
    label = kinds.pop()
    return Meaning(label, _own_name(words) if label == BONE else "", up_to_skin=soft and not in_flesh)


def preset_of(name: str, numbers: Iterable[int]) -> dict[int, tuple[str, Meaning]] | None:
    """Name and meaning of every number of a preset; None if there is no such preset.

    name : as in `PRESETS`, or the program's own name of the task
    numbers : those of the file; of several versions of a program, they select the one that knows them. If
        more than one does, and they mean different things, the result is empty.

    >>> preset_of("appendicular_bones_mr", [2])[2]
    ('tibia', Meaning(label=2, bone='tibia', up_to_skin=False))
    >>> preset_of("MuscleMap", [8161]), preset_of("MuscleMap", [8161, 8222])[8161][0]
    ({}, 'Left Tibia')
    """
    wanted = "-".join(re.findall(r"[a-z0-9]+", name.lower()))
    own = "totalsegmentator-total" if wanted == "totalsegmentator" else wanted
    spellings = [own, f"totalsegmentator-{own}", own.removeprefix("bartbols-")]
    spellings += [each.removesuffix("-mr") for each in spellings]
    presets = _presets()
    exact = next((presets[each] for each in spellings if each in presets), None)
    if exact is not None:
        return exact
    versions = [
        each for key, each in presets.items() if key.rsplit("-", 1)[0] == wanted and key[-1].isdigit()
    ]
    if not versions:
        return None
    present = set(numbers) & set().union(*versions)
    fitting = [each for each in versions if present <= set(each)]
    first = fitting[0]
    same = all(each[n][1] == first[n][1] for each in fitting[1:] for n in present)
    return fitting[-1] if same else {}


def presets_with(numbers: Iterable[int]) -> list[str]:
    """Names of the presets that know all these numbers, those with the fewest numbers first."""
    present = set(numbers) - {0}
    found = [(len(numbers_of), name) for name, numbers_of in _presets().items() if present <= set(numbers_of)]
    return [name for _, name in sorted(found)]


@cache
def _rows() -> tuple[dict[str, str], ...]:
    with _FILE.open(encoding="utf-8", newline="") as stream:
        return tuple(csv.DictReader(line for line in stream if not line.startswith("#")))


@cache
def _presets() -> dict[str, dict[int, tuple[str, Meaning]]]:
    found: dict[str, dict[int, tuple[str, Meaning]]] = {}
    for row in _rows():
        meaning = meaning_of(row["name"])
        assert meaning is not None, row
        found.setdefault(row["preset"], {})[int(row["number"])] = (row["name"], meaning)
    return found


@cache
def _known_names() -> dict[str, str]:
    return {_plain(row["name"]): row["kind"] for row in _rows()}


def _plain(name: str) -> str:
    """
    >>> _plain("Left Tensor Fasciae Latae") == _plain("left_tensor_fasciae_latae")
    True
    """
    return " ".join(re.findall(r"[a-z0-9]+", name.lower()))


def _words(name: str) -> list[str]:
    """The words of a name in lower case, up to one that says what is not in the segment."""
    words = [each.lower() for each in _WORD.findall(name)]
    return words[: next((k for k, word in enumerate(words) if word in _WITHOUT), None)]


def _own_name(words: Sequence[str]) -> str:
    """The name of the bone, if exactly one of those with their own name is meant."""
    found = {_NAMED_BONE[each] for each in words if each in _NAMED_BONE}
    return found.pop() if len(found) == 1 else ""


def _names_any(words: Sequence[str], of_kind: Sequence[str]) -> bool:
    return any(fnmatchcase(word, each) for word in words for each in of_kind)


PRESETS = tuple(dict.fromkeys(row["preset"] for row in _rows()))
