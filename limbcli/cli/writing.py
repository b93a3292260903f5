"""Where `one_writer` was; it is `limbcli.writing` now, for Python callers take turns too."""

from limbcli.writing import LOCK, one_writer

__all__ = ["LOCK", "one_writer"]
