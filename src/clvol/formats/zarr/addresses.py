"""Addresses of stores (``s3://...``, ``https://...``): which query goes with each key, and what messages must not reveal."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import parse_qsl

__all__ = ["IN_EXTRA", "name_of", "said", "shown", "split_query"]

IN_EXTRA = ("s3", "s3a", "http", "https")
"""Schemes that the extra "s3" is for."""

_HTTP = ("http", "https")
_SECRET = 6  # characters: shorter options are not redacted
_QUERY = re.compile(r"""(://[^\s?'"]*)\?[^\s'"]*""")


def shown(address: str) -> str:
    """An address for messages: without the user's password, and without the query, which may be a signature."""
    scheme, colon, rest = address.partition("://")
    server, slash, path = rest.partition("?")[0].partition("/")
    return f"{scheme}{colon}{server.rpartition('@')[2]}{slash}{path}"


def name_of(address: str) -> str:
    """The last part of an address, for messages."""
    return shown(address).rstrip("/").rpartition("/")[2] or shown(address)


def said(error: Exception, address: str, options: Mapping[str, Any] | None) -> str:
    """The message of an error with passwords, keys and signatures redacted."""
    text = str(error) or type(error).__name__
    rest = address.partition("://")[2]
    known = [rest.partition("?")[2], rest.partition("/")[0].rpartition("@")[0], *_strings(options or {})]
    for secret in sorted(known, key=len, reverse=True):
        if len(secret) >= _SECRET:
            text = text.replace(secret, "...")
    return _QUERY.sub(r"\1?...", text)  # of an address put together anew, which may be escaped in another way


def split_query(address: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """An address without its query, and options that send it with each key: a token must not end up before the key."""
    place, _, query = address.partition("?")
    if not query or address.partition("://")[0] not in _HTTP:
        return address, dict(options)
    return place, {**options, "params": [*parse_qsl(query, keep_blank_values=True), *dict(options.get("params", {})).items()]}


def _strings(options: Any, name: str = "") -> Iterator[str]:
    """Every string among options; of a server's address only the user's part."""
    if isinstance(options, Mapping):
        for key, value in options.items():
            yield from _strings(value, str(key))
    elif isinstance(options, (list, tuple)):
        for value in options:
            yield from _strings(value, name)
    elif isinstance(options, (str, bytes)):
        word = options.decode("utf-8", "replace") if isinstance(options, bytes) else options
        yield word.partition("://")[2].partition("/")[0].rpartition("@")[0] if name == "endpoint_url" else word
