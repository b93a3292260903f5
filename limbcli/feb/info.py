"""Information that limbcli's writer stores in a comment at the top of a model file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from lxml import etree

from limbcli.feb.xml import Tag

INFO_MARK = "limbcli-info "


def read_info(root: Tag) -> dict[str, Any]:
    """`LimbModel.info` of the file; empty if limbcli did not write it."""
    for comment in root.element.iterchildren(etree.Comment):
        text = (comment.text or "").strip()
        if text.startswith(INFO_MARK):
            try:
                found: Mapping[str, Any] = json.loads(text.removeprefix(INFO_MARK))
                return dict(found)
            except (ValueError, TypeError) as error:
                raise Tag(root.element, root.file).problem(
                    f"the comment '{INFO_MARK.strip()}' cannot be read ({error})", fix="remove that comment"
                ) from error
    return {}
