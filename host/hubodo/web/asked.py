"""What a visitor sends, read in bounds; and the error that is told back."""

from __future__ import annotations

import json
from typing import Any
from urllib.parse import parse_qsl

from starlette.requests import Request

_MOST_BODY = 4096


class NotServed(Exception):
    """What was asked for cannot be; status: of HTTP."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


async def body_of(request: Request) -> bytes:
    """At most some kB. Raises NotServed."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MOST_BODY:
            raise NotServed(413, "that is too long")
    return body


async def json_of(request: Request) -> dict[str, Any]:
    """An object; nothing is an empty one. Raises NotServed."""
    try:
        asked = json.loads(await body_of(request) or b"{}")
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise NotServed(400, "send a JSON object")
    return asked


def form_of(body: bytes) -> dict[str, str]:
    """The fields of a form."""
    return dict(parse_qsl(body.decode("utf-8", "replace"), max_num_fields=8))
