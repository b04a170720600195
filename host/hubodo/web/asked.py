"""What a visitor sends, read in bounds; and the error that answers it."""

from __future__ import annotations

import asyncio
import json
from typing import Any
from urllib.parse import parse_qsl

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from hubodo.safe_text import json_text

_MOST_BODY = 4096
_BODY_S = 10.0


class NotServed(Exception):
    """What was asked for cannot be; status: of HTTP."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


async def body_of(request: Request) -> bytes:
    """At most some kB. Raises NotServed."""
    body = b""
    try:
        async with asyncio.timeout(_BODY_S):
            async for part in request.stream():
                body += part
                if len(body) > _MOST_BODY:
                    raise NotServed(413, "that is too long")
    except TimeoutError:
        raise NotServed(408, "that takes too long") from None
    except ClientDisconnect:
        raise NotServed(400, "the request ended before its body") from None
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
    """Return the fields of a form. Raises NotServed for more than a form of ours has."""
    try:
        return dict(parse_qsl(body.decode("utf-8", "replace"), max_num_fields=8))
    except ValueError:
        raise NotServed(400, "that form has too many fields") from None


def json_answer(content: object, status: int = 200) -> Response:
    """Return JSON in ASCII: whatever a name or a verb's result holds, it can be sent."""
    text = json_text(content, compact=True)
    return Response(text, status, media_type="application/json")
