"""Which bone is which."""

from __future__ import annotations

from limbcli.imaging.volume import Volume

_CLEARLY_LARGER = 1.5


def name_bones(bones: tuple[Volume, ...]) -> tuple[str, ...]:
    """Names by size and place; numbers where that does not tell.

    Two bones side by side in a lower leg are tibia (the larger) and fibula.

    bones : Volumes of bool, largest first, k along the limb
    """
    sizes = [int(bone.values.sum()) for bone in bones]
    if len(bones) == 2 and sizes[0] > _CLEARLY_LARGER * sizes[1]:
        return ("tibia", "fibula")
    return tuple(str(number) for number in range(1, len(bones) + 1))
