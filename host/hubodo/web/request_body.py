"""Request bodies with bounded size and time, and the error response."""

from __future__ import annotations

import asyncio
import json
from typing import Any
from urllib.parse import parse_qsl

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from hubodo.safe_text import json_text

_MAX_BODY_BYTES = 4096
_BODY_TIMEOUT_S = 10.0


class RequestRefused(Exception):
    """A request that cannot be served; `status` is the HTTP status."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


async def read_body(request: Request) -> bytes:
    """Return the body of a request; raise RequestRefused if it is too long or too slow."""
    body = b""
    try:
        async with asyncio.timeout(_BODY_TIMEOUT_S):
            async for part in request.stream():
                body += part
                if len(body) > _MAX_BODY_BYTES:
                    raise RequestRefused(413, "the request is too long")
    except TimeoutError:
        raise RequestRefused(408, "the request takes too long") from None
    except ClientDisconnect:
        raise RequestRefused(400, "the request ended before its body") from None
    return body


async def read_json(request: Request) -> dict[str, Any]:
    """Return the JSON object in the body, {} for an empty body; raise RequestRefused if it is no object."""
    try:
        content = json.loads(await read_body(request) or b"{}")
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise RequestRefused(400, "send a JSON object")
    return content


def parse_form(body: bytes) -> dict[str, str]:
    """Return the fields of a form; raise RequestRefused if there are too many."""
    try:
        return dict(parse_qsl(body.decode("utf-8", "replace"), max_num_fields=8))
    except ValueError:
        raise RequestRefused(400, "the form has too many fields") from None


def json_response(content: object, status: int = 200) -> Response:
    """Return a JSON response in ASCII, so that any name or result can be sent."""
    text = json_text(content, compact=True)
    return Response(text, status, media_type="application/json")
