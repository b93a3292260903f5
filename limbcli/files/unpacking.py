"""One limit for whatever a file's compressed parts unpack to: some kilobytes may hold many gigabytes.

Every reader of a compressed format unpacks through a `UnpackingBudget`, one for each file that it opens.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# bytes, as many as the largest image (300 million voxels) has in numbers of eight bytes
MOST_UNPACKED = 2_500_000_000
DAMAGED = (
    OSError, EOFError, ValueError, KeyError, RuntimeError, NotImplementedError, zlib.error, lzma.LZMAError,
    struct.error, zipfile.BadZipFile, tokenize.TokenError, SyntaxError,  # the latter by headers of .npy
)  # fmt: skip
# what image libraries raise on corrupt files
LIBRARY_ERRORS = (
    OSError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, EOFError, AssertionError,
    RuntimeError, NotImplementedError, struct.error, zlib.error, MemoryError,
)  # fmt: skip
_CHUNK = 1 << 20


class UnpackingBudget:
    """How many bytes may still be unpacked from one file.

    >>> UnpackingBudget(100).gunzip(gzip.compress(b"whole"))
    b'whole'
    >>> UnpackingBudget(100).gunzip(gzip.compress(bytes(101)))
    Traceback (most recent call last):
    OSError: it unpacks to more than 0.0001 MB
    """

    def __init__(self, most: int | None = None) -> None:
        self.most = MOST_UNPACKED if most is None else most
        self.left = self.most

    def spend(self, n_bytes: int) -> None:
        """Count bytes that are about to be unpacked.

        Raises OSError if they are more than what is left.
        """
        if n_bytes > self.left:
            raise OSError(f"it unpacks to more than {self.most / 1e6:g} MB")
        self.left -= n_bytes

    def gunzip(self, content: bytes, *, first: int | None = None) -> bytes:
        """Unpacked content of a gzip file; first : only so many bytes.

        Raises OSError, EOFError, zlib.error if it is corrupt, or more than the budget.
        """
        most = self.left if first is None else min(first, self.left)
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as stream:
            unpacked = stream.read(most if first is not None else most + 1)
        self.spend(len(unpacked))
        return unpacked

    def bunzip2(self, content: bytes) -> bytes:
        """Unpacked content of a bzip2 file.

        Raises OSError, EOFError, ValueError if it is corrupt, or more than the budget.
        """
        with bz2.BZ2File(io.BytesIO(content)) as stream:
            unpacked = stream.read(self.left + 1)
        self.spend(len(unpacked))
        return unpacked

    def inflate(self, block: bytes, size: int, *, is_lzma: bool = False) -> bytes:
        """At most `size` bytes of a block of zlib or LZMA.

        Raises OSError, zlib.error, lzma.LZMAError if it is corrupt, or `size` is more than the budget.
        """
        self.spend(size)
        packer = lzma.LZMADecompressor() if is_lzma else zlib.decompressobj()
        return packer.decompress(block, size)

    def measure_deflated(self, content: bytes) -> None:
        """Count what a deflated stream without header unpacks to, keeping none of it.

        Raises OSError or zlib.error if it is corrupt, or more than the budget.
        """
        packer = zlib.decompressobj(-zlib.MAX_WBITS)
        while not packer.eof:
            unpacked = packer.decompress(content, _CHUNK)
            content = packer.unconsumed_tail
            if not unpacked and not packer.eof:
                raise zlib.error("it ends early")
            self.spend(len(unpacked))

    def part(self, package: zipfile.ZipFile, name: str) -> bytes:
        """One part of a ZIP file.

        Raises KeyError, OSError, zipfile.BadZipFile or others of `DAMAGED` if it is missing, corrupt, or
        more than the budget.
        """
        self.spend(package.getinfo(name).file_size)
        return package.read(name)


def read_npz(path: Path, *, budget: UnpackingBudget | None = None) -> dict[str, NDArray[Any]]:
    """All arrays of a `.npz` file; arrays of objects, which hold code, are refused.

    Raises one of `DAMAGED` if it is corrupt, or unpacks to more than the budget.
    """
    with zipfile.ZipFile(path) as packed:
        (budget or UnpackingBudget()).spend(sum(each.file_size for each in packed.infolist()))
    with np.load(path, allow_pickle=False) as content:
        return {name: content[name] for name in content.files}
