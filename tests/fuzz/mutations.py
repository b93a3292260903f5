"""Damage of files, by accident and by intent: bits, cuts, doubled and swapped pieces, hostile numbers.

XML is also given document types and text beside its tags, packed files content without end, and tables the
changes that people make of them: another unit, another order, lost rows, a second zero.
"""

from __future__ import annotations

import contextlib
import gzip
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


# ---------------------------------------------------------------- of XML


def document_type(content: bytes, rng: np.random.Generator) -> bytes:
    """A document type before the first element, with an entity that an attribute or a text uses."""
    start = re.search(rb"<[A-Za-z]", content)
    if start is None:
        return insert_noise(content, rng)
    inner = (b"", b' [<!ENTITY e "1">]', b' SYSTEM "file:///etc/hostname"', b' [<!ATTLIST a b CDATA "9">]')
    head = b"<!DOCTYPE a" + inner[int(rng.integers(len(inner)))] + b">"
    rest = content[start.start() :]
    values = list(re.finditer(rb'"[^"<]*"', rest))
    if values and rng.random() < 0.5:
        at = values[int(rng.integers(len(values)))]
        rest = rest[: at.start()] + b'"&e;"' + rest[at.end() :]
    return content[: start.start()] + head + rest


def text_beside_tags(content: bytes, rng: np.random.Generator) -> bytes:
    """Text or a comment behind a tag."""
    ends = [each.end() for each in re.finditer(rb">", content)]
    if not ends:
        return insert_noise(content, rng)
    at = ends[int(rng.integers(len(ends)))]
    more = (b"1,2,3", b" 0.5 ", b"<!-- 7 -->", b"<!-- 7 -->8", b"<?p q?>9", b"&#49;", b"<![CDATA[5]]>")
    return content[:at] + more[int(rng.integers(len(more)))] + content[at:]


def nested(content: bytes, rng: np.random.Generator) -> bytes:
    depth = int(rng.choice([100, 300, 3000]))
    start = re.search(rb"<[A-Za-z][^>]*>", content)
    if start is None:
        return insert_noise(content, rng)
    return content[: start.end()] + b"<q>" * depth + b"</q>" * depth + content[start.end() :]


# ---------------------------------------------------------------- of packed files


def packed_zeros(content: bytes, rng: np.random.Generator) -> bytes:
    """Another member of a gzip file, or the packed part behind a header, with many zeros."""
    begin = content.rfind(b"\x1f\x8b\x08")
    if begin < 0:
        return flip_bits(content, rng)
    more = gzip.compress(bytes(int(rng.choice([1000, 3_000_000, 40_000_000]))))
    return content + more if rng.random() < 0.5 else content[:begin] + more


# ---------------------------------------------------------------- of tables


def _cells(line: bytes) -> list[bytes]:
    return line.split(b",")


def scale_column(content: bytes, rng: np.random.Generator) -> bytes:
    """One column in another unit, with or without saying so."""
    lines = content.split(b"\n")
    width = len(_cells(lines[0]))
    k, factor = int(rng.integers(width)), float(rng.choice([0.1, 10, 1000, 1 / 4.448, 9.807, 25.4, -1]))
    out = [lines[0]]
    for line in lines[1:]:
        cells = _cells(line)
        if len(cells) == width:
            with contextlib.suppress(ValueError):
                cells[k] = repr(float(cells[k]) * factor).encode()
        out.append(b",".join(cells))
    return b"\n".join(out)


def shuffle_rows(content: bytes, rng: np.random.Generator) -> bytes:
    head, *rows = content.split(b"\n")
    order = rng.permutation(len(rows)) if rng.random() < 0.5 else np.arange(len(rows))[::-1]
    return b"\n".join([head, *(rows[k] for k in order)])


def lose_rows(content: bytes, rng: np.random.Generator) -> bytes:
    head, *rows = content.split(b"\n")
    return b"\n".join([head, *(row for row in rows if rng.random() < 0.6)])


def second_zero(content: bytes, rng: np.random.Generator) -> bytes:
    """From some row on, a column is shifted: tared, or set to zero, a second time."""
    lines = content.split(b"\n")
    width, start = len(_cells(lines[0])), int(rng.integers(1, max(2, len(lines))))
    k, shift = int(rng.integers(width)), float(rng.normal(0.0, 2.0))
    for n in range(start, len(lines)):
        cells = _cells(lines[n])
        if len(cells) == width:
            with contextlib.suppress(ValueError):
                cells[k] = repr(float(cells[k]) + shift).encode()
            lines[n] = b",".join(cells)
    return b"\n".join(lines)


def swap_columns(content: bytes, rng: np.random.Generator) -> bytes:
    lines = [_cells(line) for line in content.split(b"\n")]
    a, b = (int(rng.integers(len(lines[0]))) for _ in range(2))
    for cells in lines[1:]:
        if len(cells) == len(lines[0]):
            cells[a], cells[b] = cells[b], cells[a]
    return b"\n".join(map(b",".join, lines))


BINARY: tuple[Mutation, ...] = (
    flip_bits, flip_in_header, flip_in_header, extreme_bytes, cut_off, cut_out, double, insert_noise,
)  # fmt: skip
TEXT: tuple[Mutation, ...] = (
    flip_bits, cut_off, cut_out, double, insert_noise, hostile_number, hostile_number, hostile_number,
    other_word, move_line, move_line,
)  # fmt: skip


XML: tuple[Mutation, ...] = (*TEXT, document_type, document_type, text_beside_tags, text_beside_tags, nested)
PACKED: tuple[Mutation, ...] = (*BINARY, packed_zeros, packed_zeros)
TABLE: tuple[Mutation, ...] = (*TEXT, scale_column, shuffle_rows, lose_rows, second_zero, swap_columns)


def kinds_for(content: bytes, *, text: bool) -> tuple[Mutation, ...]:
    """The kinds of damage that suit a good file."""
    if b"\x1f\x8b\x08" in content[:4096]:
        return PACKED
    if content.lstrip()[:1] == b"<":
        return XML if text else (*BINARY, document_type, text_beside_tags)
    if text and b"," in content.split(b"\n", 1)[0]:
        return TABLE
    return TEXT if text else BINARY


def mutated(content: bytes, rng: np.random.Generator, *, text: bool) -> bytes:
    """One to three kinds of damage, one after another."""
    kinds = kinds_for(content, text=text)
    for _ in range(int(rng.integers(1, 4))):
        content = kinds[int(rng.integers(len(kinds)))](content, rng)
    return content
