"""Model files of older formats, converted on reading to format 4.0 as far as their content is in scope.

What has no counterpart is left as it stands, so that the reader names it with its line.
"""

from __future__ import annotations

from limbcli.feb.dialects.format25 import to_format_30
from limbcli.feb.dialects.format30 import to_format_40
from limbcli.feb.xml import VERSION, Tag


def convert(root: Tag) -> None:
    """Convert a file of format 2.5 or 3.0, in place; a file of format 4.0 stays as it is."""
    version = root.optional("version")
    if version == VERSION:
        return
    if version == "2.5":
        to_format_30(root)
    to_format_40(root)
    root.element.set("version", VERSION)
