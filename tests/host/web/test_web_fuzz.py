"""Random headers, paths and bodies are refused, and the server never fails."""

import socket
import string

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hubodo.log.log_writer import LogWriter
from hubodo.web.actions import _mark
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.hub import FrameHub
from hubodo.web.library import RecordingLibrary
from hubodo.web.server import serve_in_thread

TOKEN = "correct-horse-battery"
PIECES = [
    *("http://", "https://", "[", "]", "::1", "[::1", "127.0.0.1", ":8642", "@", "%", "%00"),
    *("hubodo=", "Bearer ", ";", ",", '"', "=", "\x01", "\xff", "é", "null", "?", "&", "{"),
    *("/login", "/logout", "/api/recordings/", "/api/jobs/", "/api/do/mark", "/pages/report/"),
    *('{"text": "', '"}', "\\ud800", "\\u0000", "1e999", "token=", TOKEN, " ", "\t", "a" * 300),
    *("..", "\\", "/static/", "/live", "//", "x.mcap", "0" * 30),
]
piece = st.one_of(st.sampled_from(PIECES), st.text(string.printable + "\xe9\xff\x80", max_size=6))
text = st.lists(piece, max_size=6).map("".join)
METHODS = ("GET", "POST", "PUT", "HEAD", "DELETE", "OPTIONS", "X")
NAMES = ("Host", "Origin", "Cookie", "Authorization", "Accept", "X-Hubodo-Token", "Content-Type", "Upgrade")


class FakeActions:
    """A substitute for `Actions` that only checks the text of a mark."""

    current_log = latest_snapshot = None

    def request_action(self, action, body):
        _mark(str(body.get("text", "")))


@pytest.fixture(scope="module", params=[None, TOKEN])
def server(request, tmp_path_factory):
    """Start a server without and with a token; yield its port and CSRF secret."""
    folder = tmp_path_factory.mktemp("rides")
    LogWriter(folder / "x.mcap", t_zero_ns=0).close()
    site = Site(Address("127.0.0.1", 0), request.param)
    app = make_app(site, RecordingLibrary(folder), FrameHub({}), FakeActions())
    # Guesses are not delayed in this test.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hubodo.web.guess_limiter.HOLD_S", 0.0)
        with serve_in_thread(app, site) as port:
            yield port, app.state.secrets.csrf


def one_line(raw):
    """Return the text without line ends and NUL, which h11 refuses itself."""
    return raw.replace("\r", "").replace("\n", "").replace("\0", "")


def status_of(port, request):
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        connection.sendall(request)
        answer = b""
        while b"\r\n" not in answer and (part := connection.recv(4096)):
            answer += part
    return int(answer.split(b" ")[1]) if answer else None


@settings(max_examples=75)
@given(st.data())
def test_no_random_request_causes_a_server_error(server, data):
    port, csrf = server
    method = data.draw(st.sampled_from(METHODS))
    path = "/" + one_line(data.draw(text)).replace(" ", "%20").lstrip("/")
    headers = data.draw(st.dictionaries(st.sampled_from(NAMES), text.map(one_line), max_size=4))
    if data.draw(st.booleans()):  # pass the access control, to test the code behind it
        headers = {
            name: value for name, value in headers.items() if name not in ("Host", "Origin", "Upgrade")
        }
        headers |= {"Authorization": f"Bearer {TOKEN}", "X-Hubodo-Token": csrf}
    headers.setdefault("Host", "127.0.0.1")
    body = data.draw(text).encode("utf-8", "replace")
    head = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    request = f"{method} {path} HTTP/1.1\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body
    status = status_of(port, request)
    assert status is None or status < 500, (status, request)


@pytest.mark.parametrize(
    ("request_line", "headers", "body", "status"),
    [
        ("POST /login", {"Origin": "http://[::1"}, b"", 403),
        ("POST /login", {"Origin": "http://[x]:99999"}, b"", 403),
        ("POST /login", {}, b"&".join([b"token=x"] * 20), 400),
        ("GET /", {"Host": "[::1"}, b"", 401),
        ("GET /", {"Cookie": 'hubodo="\\777"; ;;=;\x01'}, b"", 401),
        ("GET /api/jobs/" + "9" * 5000, {"Authorization": f"Bearer {TOKEN}"}, b"", 404),
        ("POST /api/do/mark", {"Authorization": f"Bearer {TOKEN}"}, b'{"text": "\\ud800"}', 202),
        ("POST /api/do/mark", {"Authorization": f"Bearer {TOKEN}"}, b'{"text": "\\u001b[2J"}', 202),
    ],
)
def test_requests_that_once_caused_a_failure_are_refused(tmp_path, request_line, headers, body, status):
    site = Site(Address("127.0.0.1", 0), TOKEN)
    with serve_in_thread(make_app(site, RecordingLibrary(tmp_path), None, FakeActions()), site) as port:
        lines = {"Host": "127.0.0.1", "Content-Length": str(len(body)), **headers}
        head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        assert status_of(port, f"{request_line} HTTP/1.1\r\n{head}\r\n".encode("latin-1") + body) == status
