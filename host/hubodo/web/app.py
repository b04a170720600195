"""The routes of the server: pages, live feed, actions, recordings and jobs."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from hubodo.ingest.live.metrics_server import respond
from hubodo.web.actions import Actions
from hubodo.web.config import Site
from hubodo.web.guard import COOKIE, AccessGuard, client_address, request_session, too_many_guesses_response
from hubodo.web.guess_limiter import GuessLimiter, TooManyGuesses
from hubodo.web.hub import FrameHub
from hubodo.web.jobs import SCRATCH, Job, JobQueue
from hubodo.web.library import RecordingFile, RecordingLibrary
from hubodo.web.preview_cache import PreviewCache
from hubodo.web.request_body import RequestRefused, json_response, parse_form, read_body, read_json
from hubodo.web.secrets import SESSION_LIFETIME_S, AccessSecrets

STATIC = Path(__file__).parent / "static"
_SEND_TIMEOUT_S = 20.0
_GENERATED_PAGE_POLICY = (
    "sandbox allow-scripts allow-popups; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
)
"""Content security policy of generated pages: scripts may draw, but not access the server."""


class RequestHandlers:
    """The request handlers and their dependencies; used only on the server's event loop."""

    def __init__(
        self,
        site: Site,
        secrets: AccessSecrets,
        limiter: GuessLimiter,
        library: RecordingLibrary,
        hub: FrameHub | None,
        actions: Actions | None,
    ) -> None:
        self._site = site
        self._secrets = secrets
        self._library = library
        self._hub = hub
        self._actions = actions
        self._limiter = limiter
        self._jobs = JobQueue(site.job_limit)
        self._previews = PreviewCache(library.derived)

    def routes(self) -> list[Route | WebSocketRoute | Mount]:
        """Return all routes."""
        return [
            Route("/", self._index),
            Route("/login", self._login, methods=["GET", "POST"]),
            Route("/logout", self._logout, methods=["POST"]),
            Route("/api/recordings", self._recordings),
            Route("/api/recordings/{name:path}", self._download),
            Route("/api/paths/{name:path}", self._path_preview),
            Route("/api/jobs", self._start_job, methods=["POST"]),
            Route("/api/jobs/{number}", self._job),
            Route("/api/jobs/{number}/cancel", self._cancel_job, methods=["POST"]),
            Route("/api/do/{action}", self._do, methods=["POST"]),
            Route("/metrics", self._machine),
            Route("/healthz", self._machine),
            Route("/pages/report/{name:path}", self._report),
            Route("/pages/gap/{name:path}", self._gap_page),
            WebSocketRoute("/live", self._live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]

    async def close(self) -> None:
        """Stop running jobs when the server ends."""
        await self._jobs.close()

    async def _index(self, request: Request) -> Response:
        text = (STATIC / "index.html").read_text("utf-8")
        return HTMLResponse(
            text.replace("{{csrf}}", self._secrets.csrf)
            .replace("{{live}}", "yes" if self._hub else "no")
            .replace("{{token}}", "yes" if self._secrets.is_token_required else "no")
        )

    async def _login(self, request: Request) -> Response:
        text = (STATIC / "login.html").read_text("utf-8")
        if request.method == "GET":
            return HTMLResponse(text.replace("{{error}}", ""))
        body = await read_body(request)
        token = parse_form(body).get("token", "")
        try:
            is_valid = await self._limiter.verify(
                client_address(request.scope), lambda: self._secrets.is_token(token)
            )
        except TooManyGuesses:
            return too_many_guesses_response()
        if not is_valid:
            return HTMLResponse(text.replace("{{error}}", "Invalid token."), 403)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(
            COOKIE,
            self._secrets.begin_session(),
            max_age=SESSION_LIFETIME_S,
            httponly=True,
            samesite="strict",
            secure=self._site.cert is not None,
        )
        return answer

    async def _logout(self, request: Request) -> Response:
        session = request_session(request.scope)
        if session is not None:
            self._secrets.end_session(session)
        answer = json_response({"ok": True})
        answer.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=self._site.cert is not None)
        return answer

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        if self._hub is None:
            await socket.close(4404)
            return
        session = request_session(socket.scope)
        reading = asyncio.ensure_future(_until_gone(socket))
        following = self._hub.subscribe()
        try:
            while not reading.done():
                waiting = asyncio.ensure_future(anext(following))
                await asyncio.wait({waiting, reading}, return_when=asyncio.FIRST_COMPLETED)
                if not waiting.done():
                    waiting.cancel()
                    with contextlib.suppress(asyncio.CancelledError):
                        await waiting
                    break
                if session is not None and not self._secrets.is_known_session(session):
                    await socket.close(4401)
                    break
                await asyncio.wait_for(socket.send_text(waiting.result()), _SEND_TIMEOUT_S)
        except (TimeoutError, WebSocketDisconnect, RuntimeError, OSError):
            pass  # the client does not read, or has disconnected
        finally:
            reading.cancel()
            await following.aclose()  # type: ignore[attr-defined]

    async def _recordings(self, request: Request) -> Response:
        current = None if self._actions is None else self._actions.current_log
        return json_response(self._library.as_json(current))

    async def _download(self, request: Request) -> Response:
        entry = self._entry(request.path_params["name"])
        name = entry.name.rpartition("/")[2]
        return FileResponse(entry.path, filename=name, media_type="application/octet-stream")

    async def _path_preview(self, request: Request) -> Response:
        entry = self._entry(request.path_params["name"])
        return Response(await self._previews.get(entry), media_type="application/json")

    async def _report(self, request: Request) -> Response:
        return self._page(request, "report.html")

    async def _gap_page(self, request: Request) -> Response:
        return self._page(request, "gap", "report.html")

    def _page(self, request: Request, *parts: str) -> Response:
        entry = self._entry(request.path_params["name"])
        page = self._library.derived.read((*entry.parts, *parts), entry.changed)
        if page is None:
            raise RequestRefused(404, "not generated yet, or the recording has changed since")
        return HTMLResponse(page, headers={"content-security-policy": _GENERATED_PAGE_POLICY})

    def _entry(self, name: str) -> RecordingFile:
        entry = self._library.find_recording(name)
        if entry is None:
            raise RequestRefused(404, "no such recording")
        return entry

    async def _machine(self, request: Request) -> Response:
        actions = self._actions
        newest, now_ns = (None, 0) if actions is None else (actions.latest_snapshot, actions.now_ns())
        status, kind, body = respond(request.url.path, newest, now_ns)
        return Response(body, status, media_type=kind)

    async def _start_job(self, request: Request) -> Response:
        body = await read_json(request)
        kind, entry = body.get("kind"), self._entry(str(body.get("name")))
        file, folder_parts = str(entry.path.absolute()), entry.parts
        if kind == "info":
            words = ["info", file]
        elif kind == "report":
            words = ["report", file, "-o", f"{SCRATCH}/report.html"]
        elif kind == "gap":
            model = self._library.list_models().get(str(body.get("model")))
            if model is None:
                raise RequestRefused(404, "no such model file; put it into the folder of the recordings")
            words, folder_parts = ["gap", str(model.absolute()), file, "-o", SCRATCH], (*entry.parts, "gap")
        else:
            raise RequestRefused(400, "kind must be info, report or gap")
        publish = None if kind == "info" else functools.partial(self._library.derived.publish, folder_parts)
        try:
            self._library.derived.check_folder(folder_parts)
        except OSError:
            raise RequestRefused(409, "a symbolic link blocks the output folder; remove it") from None
        job = self._jobs.start(kind, entry.name, words, publish)
        if job is None:
            raise RequestRefused(429, "too many jobs; wait until one is finished")
        return json_response(job.as_json(), 202)

    async def _cancel_job(self, request: Request) -> Response:
        job = self._job_of(request)
        self._jobs.cancel(job)
        return json_response(job.as_json(), 202)

    async def _job(self, request: Request) -> Response:
        return json_response(self._job_of(request).as_json())

    def _job_of(self, request: Request) -> Job:
        # Not parsed by the router, which fails on a number with thousands of digits.
        text = request.path_params["number"]
        job = self._jobs.get(int(text)) if text.isascii() and text.isdigit() and len(text) < 10 else None
        if job is None:
            raise RequestRefused(404, "no such job")
        return job

    async def _do(self, request: Request) -> Response:
        if self._actions is None:
            raise RequestRefused(404, "no recording is running")
        self._actions.request_action(request.path_params["action"], await read_json(request))
        return json_response({"ok": True}, 202)


def make_app(
    site: Site,
    library: RecordingLibrary,
    hub: FrameHub | None = None,
    actions: Actions | None = None,
) -> Starlette:
    """Return the application; hub and actions are None if only recordings are served."""
    secrets, limiter = AccessSecrets(site.token), GuessLimiter()
    pages = RequestHandlers(site, secrets, limiter, library, hub, actions)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        if hub is not None:
            hub.attach(asyncio.get_running_loop(), csrf=secrets.csrf)
        yield
        await pages.close()

    app = Starlette(
        routes=pages.routes(),
        middleware=[Middleware(AccessGuard, site=site, secrets=secrets, limiter=limiter)],
        exception_handlers={RequestRefused: _refused},
        lifespan=lifespan,
    )
    app.state.secrets = secrets
    return app


def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestRefused)
    return json_response({"error": str(error)}, error.status)


async def _until_gone(socket: WebSocket) -> None:
    """Wait until the client disconnects; discard what it sends."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_text()
