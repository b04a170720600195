"""Access control of the server: foreign host names, foreign origins, missing and invalid tokens."""

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
OWN_ORIGIN = "http://127.0.0.1:8642"


class FakeActions:
    """A substitute for `Actions` that stores the requests."""

    current_log = latest_snapshot = None

    def __init__(self):
        self.requests = []

    def request_action(self, action, body):
        self.requests.append((action, body))


def client(tmp_path, *, token=None, base=OWN_ORIGIN, **site):
    actions = FakeActions()
    own_site = Site(Address("127.0.0.1", 8642), token, **site)
    app = make_app(own_site, RecordingLibrary(tmp_path), FrameHub({}), actions)
    test_client = TestClient(app, base_url=base, follow_redirects=False)
    test_client.actions, test_client.csrf = actions, app.state.secrets.csrf
    return test_client


def mark_status(browser, **headers):
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    return browser.post("/api/do/mark", json={"text": "x"}, headers=headers).status_code


@pytest.mark.parametrize(
    ("name", "status"),
    [
        *(("evil.example", 421), ("127.0.0.1.evil.example", 421), ("localhost.evil.example:8642", 421)),
        *(("", 421), ("localhost:8642", 200), ("[::1]:8642", 200), ("192.168.7.9", 200)),
        ("recorder.lan", 200),
    ],
)
def test_a_foreign_host_name_is_refused_against_dns_rebinding(tmp_path, name, status):
    with client(tmp_path, hosts=frozenset({"recorder.lan"})) as browser:
        assert browser.get("/", headers={"host": name}).status_code == status


def test_actions_require_the_csrf_secret_and_the_own_origin(tmp_path):
    with client(tmp_path) as browser:
        assert mark_status(browser) == 403
        assert mark_status(browser, x_hubodo_token="guess") == 403
        assert mark_status(browser, x_hubodo_token=browser.csrf, origin="http://evil.example") == 403
        assert mark_status(browser, x_hubodo_token=browser.csrf, origin="http://127.0.0.1:1") == 403
        assert mark_status(browser, x_hubodo_token=browser.csrf, origin="null") == 403
        assert browser.actions.requests == []
        assert mark_status(browser, x_hubodo_token=browser.csrf, origin=OWN_ORIGIN) == 202
        assert browser.actions.requests == [("mark", {"text": "x"})]
        assert browser.csrf in browser.get("/").text


def test_the_live_feed_requires_the_own_origin(tmp_path):
    with client(tmp_path) as browser:
        for origin in ("http://evil.example", "null", "https://127.0.0.1:8642"):
            with (
                pytest.raises(WebSocketDisconnect) as refused,
                browser.websocket_connect("/live", headers={"origin": origin, "host": "127.0.0.1:8642"}),
            ):
                pass
            assert refused.value.code == 4403
        headers = {"origin": OWN_ORIGIN, "host": "127.0.0.1:8642"}
        with browser.websocket_connect("/live", headers=headers) as live:
            assert live.receive_json()["hello"]["csrf"] == browser.csrf


def test_without_the_token_only_the_login_page_is_served(tmp_path):
    with client(tmp_path, token=TOKEN) as browser:
        for path in ("/", "/api/recordings", "/api/jobs/1", "/pages/report/x.mcap", "/metrics", "/healthz"):
            assert browser.get(path).status_code == 401, path
        assert browser.get("/static/main.js").status_code == 401
        assert mark_status(browser, x_hubodo_token=browser.csrf) == 401
        host = {"host": "127.0.0.1:8642"}
        with pytest.raises(WebSocketDisconnect), browser.websocket_connect("/live", headers=host):
            pass
        shown = browser.get("/", headers={"accept": "text/html"})
        assert (shown.status_code, shown.headers["location"]) == (303, "/login")
        assert browser.get("/login").status_code == 200
        for given in ("guess", "", TOKEN + "x", TOKEN[:-1]):
            assert browser.get("/", headers={"authorization": f"Bearer {given}"}).status_code == 401
            assert browser.get("/", headers={"cookie": f"hubodo={given}"}).status_code == 401
        assert browser.actions.requests == []


def test_a_login_sets_a_session_cookie_that_does_not_contain_the_token(tmp_path):
    with client(tmp_path, token=TOKEN) as browser:
        assert browser.post("/login", data={"token": "guess"}).status_code == 403
        answer = browser.post("/login", data={"token": TOKEN})
        cookie = answer.headers["set-cookie"]
        assert answer.status_code == 303
        assert "HttpOnly" in cookie and "SameSite=strict" in cookie and "Secure" not in cookie
        assert TOKEN not in cookie
        assert browser.get("/").status_code == 200
        assert mark_status(browser) == 403
        assert mark_status(browser, x_hubodo_token=browser.csrf) == 202
        session = browser.cookies["hubodo"]
    with client(tmp_path, token=TOKEN) as again:
        assert again.get("/", headers={"cookie": f"hubodo={session}"}).status_code == 200
    with client(tmp_path, token="another-secret-token") as changed:
        assert changed.get("/", headers={"cookie": f"hubodo={session}"}).status_code == 401


def test_over_https_the_cookie_is_secure(tmp_path):
    site = Site(Address("127.0.0.1", 8642), TOKEN, cert=tmp_path / "c", key=tmp_path / "k")
    with TestClient(make_app(site, RecordingLibrary(tmp_path)), base_url="https://127.0.0.1:8642") as browser:
        answer = browser.post("/login", data={"token": TOKEN}, follow_redirects=False)
        assert "Secure" in answer.headers["set-cookie"]
        assert site.url == "https://127.0.0.1:8642/"


def test_a_program_authenticates_with_a_bearer_token(tmp_path):
    with client(tmp_path, token=TOKEN) as browser:
        headers = {"authorization": f"Bearer {TOKEN}"}
        assert browser.get("/api/recordings", headers=headers).status_code == 200
        assert browser.post("/api/do/mark", json={}, headers=headers).status_code == 202
        with browser.websocket_connect("/live", headers={**headers, "host": "127.0.0.1:8642"}) as live:
            assert "hello" in live.receive_json()


def test_secrets_are_compared_in_constant_time(monkeypatch):
    compared = []
    monkeypatch.setattr(secrets.hmac, "compare_digest", lambda given, wanted: compared.append(given))
    access = secrets.AccessSecrets(TOKEN)
    for check in (access.is_token, access.is_session, access.is_csrf):
        check("guess")
    assert compared == [b"guess"] * 3


def test_security_headers_forbid_foreign_content(tmp_path):
    with client(tmp_path, token=TOKEN) as browser:
        for path in ("/", "/login", "/nowhere"):
            headers = browser.get(path, headers={"authorization": f"Bearer {TOKEN}"}).headers
            assert "default-src 'none'" in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["cache-control"] == "no-store"
            assert "server" not in headers


def test_long_and_malformed_bodies_are_refused(tmp_path):
    with client(tmp_path) as browser:
        headers = {"x-hubodo-token": browser.csrf}
        assert browser.post("/api/do/mark", content=b"x" * 5000, headers=headers).status_code == 413
        for body in (b"[1]", b"{", b"\xff", b"[" * 4000):
            assert browser.post("/api/do/mark", content=body, headers=headers).status_code == 400
        assert browser.actions.requests == []


@pytest.mark.parametrize(
    ("text", "host", "port", "is_loopback"),
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
def test_an_address_without_a_host_is_the_loopback_address(text, host, port, is_loopback):
    address = parse_address(text, 8642)
    assert (address.host, address.port, address.is_loopback) == (host, port, is_loopback)


@pytest.mark.parametrize("text", ["left=/dev/ttyACM0", "/dev/ttyACM0", "host:port", "host:99999", "a b"])
def test_an_invalid_address_is_refused(text):
    with pytest.raises(InputError, match="HOST:PORT"):
        parse_address(text, 8642)


def test_serving_other_computers_requires_a_strong_token_in_a_private_file(tmp_path, monkeypatch):
    monkeypatch.delenv("HUBODO_WEB_TOKEN_FILE", raising=False)
    open_to_all = WebConfig(listen="0.0.0.0:0")
    with pytest.raises(InputError, match="--token-file"):
        web_site(open_to_all)
    file = tmp_path / "token"
    for content, mode, message in (
        ("short", 0o600, "16 characters"),
        ("abab" * 8, 0o600, "6 distinct"),
        (TOKEN, 0o644, "chmod 600"),
        ("ä" * 20, 0o600, "plain ASCII"),
    ):
        file.write_text(content, "utf-8")
        file.chmod(mode)
        with pytest.raises(InputError, match=message) as refused:
            read_token(file)
        assert content not in str(refused.value)
    file.write_text(TOKEN + "\n")
    assert web_site(open_to_all, {"HUBODO_WEB_TOKEN_FILE": str(file)}).token == TOKEN
    with pytest.raises(InputError, match="both"):
        web_site(WebConfig(listen="", cert="cert.pem"))
    with pytest.raises(InputError, match="does not exist"):
        web_site(WebConfig(listen="", cert="cert.pem", key="key.pem"))


def test_invalid_options_of_record_and_serve_are_refused_in_one_line(tmp_path):
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


def test_guesses_are_limited_for_every_kind_of_login_and_sessions_are_not_delayed(tmp_path, monkeypatch):
    slept = []

    async def sleep(seconds):
        slept.append(seconds)

    monkeypatch.setattr(GuessLimiter.__init__, "__defaults__", (lambda: 0.0, sleep))
    host = {"host": "127.0.0.1:8642"}

    def open_live_feed(browser, headers):
        with pytest.raises(WebSocketDisconnect), browser.websocket_connect("/live", headers=host | headers):
            pass

    logins = {
        "form": lambda browser: browser.post("/login", data={"token": "guess"}),
        "bearer": lambda browser: browser.get("/", headers={"authorization": "Bearer guess"}),
        "cookie": lambda browser: browser.get("/", headers={"cookie": "hubodo=guess"}),
        "live feed": lambda browser: open_live_feed(browser, {"cookie": "hubodo=guess"}),
        "program": lambda browser: open_live_feed(browser, {"authorization": "Bearer guess"}),
    }
    for name, guess in logins.items():
        with client(tmp_path, token=TOKEN) as browser:
            assert browser.post("/login", data={"token": TOKEN}).status_code == 303
            session = {"cookie": f"hubodo={browser.cookies['hubodo']}"}
            browser.cookies.clear()
            slept.clear()
            for _ in range(int(ALLOWANCE)):
                guess(browser)
            assert slept == [], name
            guess(browser)
            assert slept == [HOLD_S], name
            assert browser.get("/", headers=session).status_code == 200
            assert slept == [HOLD_S], name


def test_a_logout_ends_the_session_on_the_server_and_requires_the_csrf_secret(tmp_path):
    with client(tmp_path, token=TOKEN) as browser:
        browser.post("/login", data={"token": TOKEN})
        session = {"cookie": f"hubodo={browser.cookies['hubodo']}"}
        assert browser.post("/logout").status_code == 403
        assert browser.get("/", headers=session).status_code == 200
        answer = browser.post("/logout", headers={"x-hubodo-token": browser.csrf})
        assert answer.status_code == 200 and "Max-Age=0" in answer.headers["set-cookie"]
        assert browser.get("/", headers=session).status_code == 401


def test_a_live_feed_ends_with_its_session(tmp_path):
    hub = FrameHub({})
    app = make_app(Site(Address("127.0.0.1", 8642), TOKEN), RecordingLibrary(tmp_path), hub)
    with TestClient(app, base_url=OWN_ORIGIN) as browser:
        browser.post("/login", data={"token": TOKEN}, follow_redirects=False)
        headers = {"host": "127.0.0.1:8642", "cookie": f"hubodo={browser.cookies['hubodo']}"}
        with browser.websocket_connect("/live", headers=headers) as live:
            assert "hello" in live.receive_json()
            hub.put({"t": 1.0})
            assert live.receive_json() == {"t": 1.0}
            app.state.secrets.end_session(browser.cookies["hubodo"])
            hub.put({"t": 2.0})
            with pytest.raises(WebSocketDisconnect) as ended:
                live.receive_json()
            assert ended.value.code == 4401
