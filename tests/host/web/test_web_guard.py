"""Who may speak to the server: foreign names, foreign pages, visitors without the token or with another."""

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hubodo.errors import InputError
from hubodo.web import secrets
from hubodo.web.address import Address, parse_address
from hubodo.web.app import make_app
from hubodo.web.config import Site, WebConfig, read_token, web_site
from hubodo.web.guess_limiter import ALLOWANCE, HOLD_S, GuessLimiter
from hubodo.web.hub import FrameHub
from hubodo.web.library import RecordingLibrary
from in_process import hubodo

TOKEN = "correct-horse-battery"
HERE = "http://127.0.0.1:8642"


class Wishes:
    """Stands for `Actions`."""

    current_log = latest_snapshot = None

    def __init__(self):
        self.done = []

    def request_action(self, action, body):
        self.done.append((action, body))


def client(tmp_path, *, token=None, base=HERE, **site):
    wishes = Wishes()
    place = Site(Address("127.0.0.1", 8642), token, **site)
    app = make_app(place, RecordingLibrary(tmp_path), FrameHub({}), wishes)
    made = TestClient(app, base_url=base, follow_redirects=False)
    made.wishes, made.csrf = wishes, app.state.secrets.csrf
    return made


def asks(made, **headers):
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    return made.post("/api/do/mark", json={"text": "x"}, headers=headers).status_code


@pytest.mark.parametrize(
    ("name", "status"),
    [
        *(("evil.example", 421), ("127.0.0.1.evil.example", 421), ("localhost.evil.example:8642", 421)),
        *(("", 421), ("localhost:8642", 200), ("[::1]:8642", 200), ("192.168.7.9", 200)),
        ("recorder.lan", 200),
    ],
)
def test_a_name_that_is_not_its_own_is_refused_so_that_name_services_cannot_be_turned_on_it(
    tmp_path, name, status
):
    with client(tmp_path, hosts=frozenset({"recorder.lan"})) as made:
        assert made.get("/", headers={"host": name}).status_code == status


def test_only_a_page_of_its_own_may_ask_for_anything(tmp_path):
    with client(tmp_path) as made:
        assert asks(made) == 403
        assert asks(made, x_hubodo_token="guess") == 403
        assert asks(made, x_hubodo_token=made.csrf, origin="http://evil.example") == 403
        assert asks(made, x_hubodo_token=made.csrf, origin="http://127.0.0.1:1") == 403
        assert asks(made, x_hubodo_token=made.csrf, origin="null") == 403
        assert made.wishes.done == []
        assert asks(made, x_hubodo_token=made.csrf, origin=HERE) == 202
        assert made.wishes.done == [("mark", {"text": "x"})]
        assert made.csrf in made.get("/").text


def test_the_live_feed_is_for_pages_of_its_own(tmp_path):
    with client(tmp_path) as made:
        for origin in ("http://evil.example", "null", "https://127.0.0.1:8642"):
            with (
                pytest.raises(WebSocketDisconnect) as refused,
                made.websocket_connect("/live", headers={"origin": origin, "host": "127.0.0.1:8642"}),
            ):
                pass
            assert refused.value.code == 4403
        headers = {"origin": HERE, "host": "127.0.0.1:8642"}
        with made.websocket_connect("/live", headers=headers) as live:
            assert live.receive_json()["hello"]["csrf"] == made.csrf


def test_without_the_token_nothing_but_the_way_to_give_it_is_shown(tmp_path):
    with client(tmp_path, token=TOKEN) as made:
        for path in ("/", "/api/recordings", "/api/jobs/1", "/pages/report/x.mcap", "/metrics", "/healthz"):
            assert made.get(path).status_code == 401, path
        assert made.get("/static/main.js").status_code == 401
        assert asks(made, x_hubodo_token=made.csrf) == 401
        host = {"host": "127.0.0.1:8642"}
        with pytest.raises(WebSocketDisconnect), made.websocket_connect("/live", headers=host):
            pass
        shown = made.get("/", headers={"accept": "text/html"})
        assert (shown.status_code, shown.headers["location"]) == (303, "/login")
        assert made.get("/login").status_code == 200
        for given in ("guess", "", TOKEN + "x", TOKEN[:-1]):
            assert made.get("/", headers={"authorization": f"Bearer {given}"}).status_code == 401
            assert made.get("/", headers={"cookie": f"hubodo={given}"}).status_code == 401
        assert made.wishes.done == []


def test_the_token_is_given_once_and_a_cookie_that_is_not_the_token_from_then_on(tmp_path):
    with client(tmp_path, token=TOKEN) as made:
        assert made.post("/login", data={"token": "guess"}).status_code == 403
        answer = made.post("/login", data={"token": TOKEN})
        cookie = answer.headers["set-cookie"]
        assert answer.status_code == 303
        assert "HttpOnly" in cookie and "SameSite=strict" in cookie and "Secure" not in cookie
        assert TOKEN not in cookie
        assert made.get("/").status_code == 200
        assert asks(made) == 403
        assert asks(made, x_hubodo_token=made.csrf) == 202
        kept = made.cookies["hubodo"]
    with client(tmp_path, token=TOKEN) as again:
        assert again.get("/", headers={"cookie": f"hubodo={kept}"}).status_code == 200
    with client(tmp_path, token="another-secret-token") as changed:
        assert changed.get("/", headers={"cookie": f"hubodo={kept}"}).status_code == 401


def test_over_https_the_cookie_stays_there(tmp_path):
    site = Site(Address("127.0.0.1", 8642), TOKEN, cert=tmp_path / "c", key=tmp_path / "k")
    with TestClient(make_app(site, RecordingLibrary(tmp_path)), base_url="https://127.0.0.1:8642") as made:
        answer = made.post("/login", data={"token": TOKEN}, follow_redirects=False)
        assert "Secure" in answer.headers["set-cookie"]
        assert site.url == "https://127.0.0.1:8642/"


def test_a_program_gives_the_token_with_each_request(tmp_path):
    with client(tmp_path, token=TOKEN) as made:
        headers = {"authorization": f"Bearer {TOKEN}"}
        assert made.get("/api/recordings", headers=headers).status_code == 200
        assert made.post("/api/do/mark", json={}, headers=headers).status_code == 202
        with made.websocket_connect("/live", headers={**headers, "host": "127.0.0.1:8642"}) as live:
            assert "hello" in live.receive_json()


def test_secrets_are_compared_in_constant_time(monkeypatch):
    compared = []
    monkeypatch.setattr(secrets.hmac, "compare_digest", lambda given, wanted: compared.append(given))
    known = secrets.AccessSecrets(TOKEN)
    for check in (known.is_token, known.is_session, known.is_csrf):
        check("guess")
    assert compared == [b"guess"] * 3


def test_browsers_are_told_to_load_nothing_from_elsewhere(tmp_path):
    with client(tmp_path, token=TOKEN) as made:
        for path in ("/", "/login", "/nowhere"):
            headers = made.get(path, headers={"authorization": f"Bearer {TOKEN}"}).headers
            assert "default-src 'none'" in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["cache-control"] == "no-store"
            assert "server" not in headers


def test_what_is_sent_is_read_in_bounds(tmp_path):
    with client(tmp_path) as made:
        headers = {"x-hubodo-token": made.csrf}
        assert made.post("/api/do/mark", content=b"x" * 5000, headers=headers).status_code == 413
        for body in (b"[1]", b"{", b"\xff", b"[" * 4000):
            assert made.post("/api/do/mark", content=body, headers=headers).status_code == 400
        assert made.wishes.done == []


@pytest.mark.parametrize(
    ("text", "host", "port", "alone"),
    [
        ("", "127.0.0.1", 8642, True),
        ("9000", "127.0.0.1", 9000, True),
        (":9000", "127.0.0.1", 9000, True),
        ("localhost", "localhost", 8642, True),
        ("[::1]:80", "::1", 80, True),
        ("127.9.9.9:1", "127.9.9.9", 1, True),
        ("0.0.0.0:80", "0.0.0.0", 80, False),
        ("[::]:80", "::", 80, False),
        ("lan", "lan", 8642, False),
    ],
)
def test_an_address_without_a_host_is_this_computer_alone(text, host, port, alone):
    address = parse_address(text, 8642)
    assert (address.host, address.port, address.is_loopback) == (host, port, alone)


@pytest.mark.parametrize("text", ["left=/dev/ttyACM0", "/dev/ttyACM0", "host:port", "host:99999", "a b"])
def test_what_is_no_address_is_said(text):
    with pytest.raises(InputError, match="HOST:PORT"):
        parse_address(text, 8642)


def test_others_are_not_served_without_a_token_that_is_kept_secret(tmp_path, monkeypatch):
    monkeypatch.delenv("HUBODO_WEB_TOKEN_FILE", raising=False)
    open_to_all = WebConfig(listen="0.0.0.0:0")
    with pytest.raises(InputError, match="--token-file"):
        web_site(open_to_all)
    file = tmp_path / "token"
    for content, mode, says in (
        ("short", 0o600, "16 characters"),
        ("abab" * 8, 0o600, "6 distinct"),
        (TOKEN, 0o644, "chmod 600"),
        ("ä" * 20, 0o600, "plain ASCII"),
    ):
        file.write_text(content, "utf-8")
        file.chmod(mode)
        with pytest.raises(InputError, match=says) as refused:
            read_token(file)
        assert content not in str(refused.value)
    file.write_text(TOKEN + "\n")
    assert web_site(open_to_all, {"HUBODO_WEB_TOKEN_FILE": str(file)}).token == TOKEN
    with pytest.raises(InputError, match="both"):
        web_site(WebConfig(listen="", cert="cert.pem"))
    with pytest.raises(InputError, match="does not exist"):
        web_site(WebConfig(listen="", cert="cert.pem", key="key.pem"))


def test_the_commands_refuse_in_one_line(tmp_path):
    log = tmp_path / "x.mcap"
    done = hubodo("record", "/dev/null", "-o", log, "--web", "0.0.0.0:0")
    assert (done.code, done.err.count("\n")) == (2, 1) and "--token-file" in done.err
    done = hubodo("record", "-o", log, "--web", "left=/dev/ttyACM0")
    assert done.code == 2 and "no port" in done.err
    done = hubodo("serve", tmp_path / "none")
    assert (done.code, done.err.count("\n")) == (2, 1) and "is no folder" in done.err
    done = hubodo("serve", tmp_path, "--at", "0.0.0.0:0")
    assert done.code == 2 and "--token-file" in done.err
    assert list(tmp_path.iterdir()) == []


def test_guesses_are_limited_on_every_way_in_and_a_session_passes_beside_them(tmp_path, monkeypatch):
    slept = []

    async def sleep(seconds):
        slept.append(seconds)

    monkeypatch.setattr(GuessLimiter.__init__, "__defaults__", (lambda: 0.0, sleep))
    host = {"host": "127.0.0.1:8642"}

    def live(made, headers):
        with pytest.raises(WebSocketDisconnect), made.websocket_connect("/live", headers=host | headers):
            pass

    ways = {
        "form": lambda made: made.post("/login", data={"token": "guess"}),
        "bearer": lambda made: made.get("/", headers={"authorization": "Bearer guess"}),
        "cookie": lambda made: made.get("/", headers={"cookie": "hubodo=guess"}),
        "live feed": lambda made: live(made, {"cookie": "hubodo=guess"}),
        "program": lambda made: live(made, {"authorization": "Bearer guess"}),
    }
    for name, way in ways.items():
        with client(tmp_path, token=TOKEN) as made:
            assert made.post("/login", data={"token": TOKEN}).status_code == 303
            session = {"cookie": f"hubodo={made.cookies['hubodo']}"}
            made.cookies.clear()
            slept.clear()
            for _ in range(int(ALLOWANCE)):
                way(made)
            assert slept == [], name
            way(made)
            assert slept == [HOLD_S], name
            assert made.get("/", headers=session).status_code == 200
            assert slept == [HOLD_S], name


def test_a_logout_ends_the_session_on_the_server_and_needs_a_page_of_its_own(tmp_path):
    with client(tmp_path, token=TOKEN) as made:
        made.post("/login", data={"token": TOKEN})
        session = {"cookie": f"hubodo={made.cookies['hubodo']}"}
        assert made.post("/logout").status_code == 403
        assert made.get("/", headers=session).status_code == 200
        answer = made.post("/logout", headers={"x-hubodo-token": made.csrf})
        assert answer.status_code == 200 and "Max-Age=0" in answer.headers["set-cookie"]
        assert made.get("/", headers=session).status_code == 401


def test_a_live_feed_ends_with_its_session(tmp_path):
    hub = FrameHub({})
    app = make_app(Site(Address("127.0.0.1", 8642), TOKEN), RecordingLibrary(tmp_path), hub)
    with TestClient(app, base_url=HERE) as made:
        made.post("/login", data={"token": TOKEN}, follow_redirects=False)
        headers = {"host": "127.0.0.1:8642", "cookie": f"hubodo={made.cookies['hubodo']}"}
        with made.websocket_connect("/live", headers=headers) as live:
            assert "hello" in live.receive_json()
            hub.put({"t": 1.0})
            assert live.receive_json() == {"t": 1.0}
            app.state.secrets.end_session(made.cookies["hubodo"])
            hub.put({"t": 2.0})
            with pytest.raises(WebSocketDisconnect) as ended:
                live.receive_json()
            assert ended.value.code == 4401
