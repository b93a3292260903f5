"""case.toml as a JSON Schema, from which editors complete its keys and mark what is wrong.

What several keys say together, and whether files exist, is left to `limbcli check`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.imaging import SHAPE
from limbcli.case.schema import Key
from limbcli.case.socket import INNER as IN_SOCKET
from limbcli.version import __version__

FILE = "case.schema.json"
_DRAFT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def case_schema() -> Schema:
    """The JSON Schema (draft 2020-12) of case.toml, format 1.

    >>> case_schema()["properties"]["subject"]["properties"]["limb"]["enum"]
    ['left', 'right']
    """
    site = _table(
        schema.SITE,
        noise=_table(schema.NOISE),
        layers=_object({name: _table(schema.LAYER) for name in schema.LAYER_NAMES}),
        pennation=_list(_table(schema.PENNATION)),
        state=_list(_table(schema.STATE)),
        **{name: _table(keys) for name, keys in schema.INSTRUMENTS.items()},
    )
    site["required"].remove("levels")
    site["anyOf"] = [{"required": ["levels"]}, {"required": ["state"]}]
    whole = _table(
        schema.TOP,
        subject=_table(schema.SUBJECT),
        files=_table(schema.FILES),
        imaging=_table(schema.IMAGING, shape=_table(SHAPE), labels=_labels()),
        probe=_table(schema.PROBE),
        model=_table(schema.MODEL),
        socket=_table(schema.SOCKET, knee=_table(schema.KNEE), liner=_table(schema.LINER), **IN_SOCKET),
        site=_list(site),
    )
    whole["required"] = ["format", "subject", "imaging", "probe", "site"]
    head = {"$schema": _DRAFT, "title": "case.toml", "$comment": f"written by limbcli {__version__}"}
    return {**head, **whole}


def _table(keys: Mapping[str, Key], **inner: Schema) -> Schema:
    properties = {name: _key(key, inner.get(name)) for name, key in keys.items()}
    return {**_object(properties), "required": [name for name, key in keys.items() if key.required]}


def _key(key: Key, inner: Schema | None) -> Schema:
    usual = {} if key.default in (None, {}) else {"default": key.default}
    return {"description": key.kind, **(schema.JSON.get(key.check, {}) if inner is None else inner), **usual}


def _object(properties: Mapping[str, Schema]) -> Schema:
    return {"type": "object", "properties": dict(properties), "additionalProperties": False}


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items, "minItems": 1}


def _labels() -> Schema:
    one = {"type": "object", "required": ["file"], "additionalProperties": {"type": "string"}}
    either: list[Schema] = [{"type": "string"}, one]
    return {"anyOf": [*either, _list({"anyOf": either})]}
