"""Damage of files, by accident and by intent: bits, cuts, doubled and swapped pieces, hostile numbers."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

HOSTILE = (
    "0", "-1", "-0.0", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "99999999999",
    "9223372036854775808", "-2147483649", "1e400", "", "abc", "1,5", "0x10", "1_000", "\u0663", "\x00",
    "../../x", "\ufeff", "NaN", "1e3",
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}")

Mutation = Callable[[bytes, np.random.Generator], bytes]


def _spot(content: bytes, rng: np.random.Generator) -> tuple[int, int]:
    start = int(rng.integers(0, len(content) + 1))
    return start, min(len(content), start + int(rng.integers(1, 40)))


def flip_bits(content: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(content)
    for at in rng.integers(0, max(len(out), 1), size=int(rng.integers(1, 6))):
        if out:
            out[at] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def flip_in_header(content: bytes, rng: np.random.Generator) -> bytes:
    """Bits of the first 400 bytes, where the formats keep their sizes."""
    return flip_bits(content[:400], rng) + content[400:]


def extreme_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(0, max(len(content), 1)))
    fill = bytes([int(rng.choice([0, 0xFF, 0x7F, 0x80]))]) * int(rng.choice([1, 2, 4, 8]))
    return content[:start] + fill + content[start + len(fill) :]


def cut_off(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(0, len(content) + 1))]


def cut_out(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = _spot(content, rng)
    return content[:start] + content[end:]


def double(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = _spot(content, rng)
    return content[:end] + content[start:end] * int(rng.integers(1, 4)) + content[end:]


def insert_noise(content: bytes, rng: np.random.Generator) -> bytes:
    start, _ = _spot(content, rng)
    return content[:start] + rng.bytes(int(rng.integers(1, 24))) + content[start:]


def hostile_number(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return insert_noise(content, rng)
    at = found[int(rng.integers(len(found)))]
    return content[: at.start()] + str(rng.choice(HOSTILE)).encode() + content[at.end() :]


def other_word(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(_WORD.finditer(content))
    if not found:
        return flip_bits(content, rng)
    a, b = (found[int(rng.integers(len(found)))] for _ in range(2))
    return content[: a.start()] + b[0] + content[a.end() :]


def move_line(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    line = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(0, 3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b"\n".join(lines)


BINARY: tuple[Mutation, ...] = (
    flip_bits, flip_in_header, flip_in_header, extreme_bytes, cut_off, cut_out, double, insert_noise,
)  # fmt: skip
TEXT: tuple[Mutation, ...] = (
    flip_bits, cut_off, cut_out, double, insert_noise, hostile_number, hostile_number, hostile_number,
    other_word, move_line, move_line,
)  # fmt: skip


def mutated(content: bytes, rng: np.random.Generator, *, text: bool) -> bytes:
    """One to three kinds of damage, one after another."""
    kinds = TEXT if text else BINARY
    for _ in range(int(rng.integers(1, 4))):
        content = kinds[int(rng.integers(len(kinds)))](content, rng)
    return content
