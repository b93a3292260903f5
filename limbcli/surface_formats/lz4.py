"""Unpack a block of LZ4, as VTK's XML files hold them.

Format: LZ4 Block Format Description (github.com/lz4/lz4, doc/lz4_Block_format.md). These few lines stand in
for a compiled package that nothing else here needs.
"""

from __future__ import annotations


def unpacked(block: bytes, size: int) -> bytes:
    """The `size` bytes of a block.

    Raises ValueError if it is damaged.

    >>> unpacked(b"\\x23ab\\x02\\x00\\x10c", 10)
    b'ababababac'
    """
    found, at = bytearray(), 0
    while at < len(block):
        token = block[at]
        n_plain, at = _length(block, at + 1, token >> 4)
        found += block[at : at + n_plain]
        at += n_plain
        if at >= len(block):
            break
        back = int.from_bytes(block[at : at + 2], "little")
        n_copied, at = _length(block, at + 2, token & 15)
        start = len(found) - back
        if back == 0 or start < 0 or len(found) + n_copied + 4 > size:
            raise ValueError("an LZ4 block is damaged")
        piece = bytes(found[start : start + n_copied + 4])
        found += (piece * (-(-(n_copied + 4) // len(piece))))[: n_copied + 4]
    if len(found) != size:
        raise ValueError(f"an LZ4 block has {len(found)} bytes instead of {size}")
    return bytes(found)


def _length(block: bytes, at: int, nibble: int) -> tuple[int, int]:
    """A length that begins in four bits of the token, and the place behind it."""
    length = nibble
    while nibble == 15:
        more = block[at] if at < len(block) else 0
        length, at = length + more, at + 1
        if more != 255:
            break
    return length, at
