"""The node's side of an update: what it accepts, refuses and leaves, with the real file system calls."""

import hashlib
import sys
from types import SimpleNamespace

import pytest
import real_micropython
from commands import Commands
from framing import PAYLOAD
from radio import switch, trial, update
from test_firmware_link_memory import FAKES
from test_firmware_memory import ROOM

from hubowire import decode, encode
from hubowire.messages import (
    Ack,
    GetHello,
    Nack,
    Ping,
    Reason,
    SetConfig,
    UpdatePiece,
    UpdateStart,
    UpdateState,
)
from hubowire.messages import UpdateStatus as S
from virtual_runs import messages_of, request, run

FILES = {
    "node.mpy": b"n" * 700,
    "drivers/a.mpy": b"same",
    "main.py": b'SLOTS = ("/fw_b", "/fw_a")\nload(SLOTS)()\n',
}


class FakeOutbox:
    """Collects messages as `Outbox` does, without framing."""

    node_id = 1

    def __init__(self):
        self.sent = []
        self._raw = bytearray(256)

    def note(self):
        return self._raw

    def post(self, type_id, size):
        self.sent.append(decode(type_id, bytes(self._raw[PAYLOAD : PAYLOAD + size])))


class FakeNode:
    """A node on a sealed link that runs slot A of a temporary file system."""

    def __init__(self):
        self.board = SimpleNamespace(feed=lambda: None)
        self.outbox = FakeOutbox()
        self.parts = SimpleNamespace(mag=1, faults=0)
        self.estimator, self.warm, self.slow, self.leave = 1, (1,), None, None
        self.link = FakeSealed.SealedLink()
        self.commands = Commands(self)
        self.stopped = False

    def stop(self):
        self.stopped = True

    def request(self, message):
        """Execute a request as the main loop does; return the answers."""
        payload = encode(message)
        raw = bytearray(PAYLOAD) + payload
        frame = SimpleNamespace(node=1, type_id=message.type_id, seq=7, raw=raw, size=len(payload))
        self.outbox.sent.clear()
        # It unloads itself; the paths of this one are those of the test.
        sys.modules["radio.update"] = update
        self.commands.handle(frame, 0)
        return list(self.outbox.sent)

    def check_all(self):
        """Run the duties until a piece is awaited, or the update ends."""
        for _ in range(20):
            if self.slow.status == S.CHECKING:
                self.slow.step(0)
        return self.slow.status


class FakeSealed:
    class SealedLink:
        pass


def pieces(number, content, size=235):
    for at in range(0, len(content), size):
        yield UpdatePiece(number, at, tuple((byte,) for byte in content[at : at + size]))


@pytest.fixture
def disk(tmp_path, monkeypatch):
    """Redirect the paths of update.py to a folder with slot A and the old main.py."""
    slots = tuple(str(tmp_path / name) for name in ("fw_a", "fw_b"))
    monkeypatch.setattr(update, "_SLOTS", slots)
    monkeypatch.setattr(switch, "_FILES_ROOT", f"{tmp_path}/")
    monkeypatch.setattr(trial, "ticks_ms", lambda: 0)
    monkeypatch.setattr(trial, "_FILES", tuple(str(tmp_path / name) for name in ("main.py", "config.json")))
    monkeypatch.setattr(update, "_NEW_MAIN", str(tmp_path / "main.py.new"))
    monkeypatch.setattr(update, "ticks_ms", lambda: 0)
    modules = {"sealed": FakeSealed, "drivers": SimpleNamespace(a=1), "drivers.a": 1}
    system = SimpleNamespace(modules=modules, path=[slots[0]], implementation=sys.implementation)
    monkeypatch.setattr(update, "sys", system)
    (tmp_path / "fw_a" / "drivers").mkdir(parents=True)
    (tmp_path / "fw_a" / "drivers" / "a.mpy").write_bytes(FILES["drivers/a.mpy"])
    (tmp_path / "fw_b" / "drivers").mkdir(parents=True)
    (tmp_path / "fw_b" / "drivers" / "stale.py").write_bytes(b"of an older firmware")
    (tmp_path / "main.py").write_bytes(b"old main")
    return tmp_path


def listing(files=FILES):
    return "".join(f"{hashlib.sha256(c).hexdigest()} {len(c)} {n}\n" for n, c in files.items()).encode()


def start(slot=1, files=FILES):
    return UpdateStart(slot, len(listing(files)), hashlib.sha256(listing(files)).digest())


def begun(node, files=FILES):
    (state,) = node.request(start(files=files))
    assert (state.status, state.file, state.offset) == (S.WAITING, 0, 0)
    for piece in pieces(0, listing(files)):
        node.request(piece)
    return node


def test_files_come_in_order_the_stale_one_goes_and_main_py_is_replaced_last(disk):
    node = FakeNode()
    (query,) = node.request(UpdateStart(0, 0, bytes(32)))
    assert (query.status, query.slot) == (S.IDLE, 1) and not node.stopped
    (other,) = node.request(start(slot=0))
    assert other.status == S.IDLE and not node.stopped, "the slot that runs is never written"
    begun(node)
    assert node.stopped and not (disk / "fw_b" / "drivers" / "stale.py").exists()
    assert node.check_all() == S.WAITING and node.slow._file == 1
    first, second, third = pieces(1, FILES["node.mpy"])
    for early in (second, third, UpdatePiece(2, 0, first.data), UpdatePiece(1, 1, first.data)):
        (state,) = node.request(early)
        assert (state.status, state.file, state.offset) == (S.WAITING, 1, 0)
    for piece in pieces(1, FILES["node.mpy"]):
        node.request(piece)
        (state,) = node.request(piece)
    assert state.status == S.CHECKING, "a piece that comes twice is written once"
    assert node.check_all() == S.WAITING and node.slow._file == 3, "drivers/a.mpy is copied on the node"
    assert (disk / "main.py").read_bytes() == b"old main"
    for piece in pieces(3, FILES["main.py"]):
        node.request(piece)
    assert node.leave is None and node.check_all() == S.COMPLETE and node.leave == 0
    assert {
        p.relative_to(disk / "fw_b").as_posix(): p.read_bytes() for p in (disk / "fw_b").rglob("*.*")
    } == {name: content for name, content in FILES.items() if name != "main.py"}
    assert (disk / "main.py.new").read_bytes() == FILES["main.py"]
    assert (disk / "main.py.old").read_bytes() == b"old main"
    first_start = (disk / "main.py").read_bytes()
    assert first_start.startswith(b'SLOTS = ("/fw_b", "/fw_a")') and b"(SLOTS[:1])(config" in first_start


def test_after_a_restart_complete_files_are_not_requested_again_unless_the_firmware_is_another(disk):
    node = begun(FakeNode())
    node.check_all()
    for piece in pieces(1, FILES["node.mpy"]):
        node.request(piece)
    again = FakeNode()
    (state,) = again.request(start())
    assert state.status == S.CHECKING
    assert again.check_all() == S.WAITING and again.slow._file == 3
    (state,) = again.request(start(files=FILES | {"node.mpy": b"other"}))
    assert again.leave == 0, "another firmware starts after a restart"
    other = begun(FakeNode(), FILES | {"node.mpy": b"other"})
    assert other.check_all() == S.WAITING and other.slow._file == 1
    assert not list((disk / "fw_b").rglob("a.mpy"))


def test_a_file_that_differs_is_removed_and_the_old_firmware_stays(disk):
    node = begun(FakeNode())
    node.check_all()
    for piece in pieces(1, b"x" * 700):
        (state,) = node.request(piece)
    assert state.status == S.DAMAGED and node.leave == 0
    assert not (disk / "fw_b" / "node.mpy").exists() and (disk / "main.py").read_bytes() == b"old main"


def test_a_full_flash_ends_the_update(disk, monkeypatch):
    node = begun(FakeNode())
    node.check_all()

    class Full:
        def write(self, data):
            raise OSError(28)

    node.slow._out = Full()
    (state,) = node.request(next(pieces(1, FILES["node.mpy"])))
    assert state.status == S.NOT_STORED and node.leave == 0


def test_only_requests_without_sensors_are_executed_meanwhile_and_silence_ends_the_update(disk, monkeypatch):
    monkeypatch.setattr("reports.hello", lambda node: node.outbox.sent.append("Hello"))
    node = begun(FakeNode())
    assert node.request(SetConfig(2, 104)) == [Nack(SetConfig.type_id, 7, Reason.BUSY, 0)]
    assert node.request(Ping()) == [Ack(Ping.type_id, 7)] and node.request(GetHello()) == ["Hello"]
    node.slow.step(59_999)
    assert node.leave is None
    node.slow.step(60_000)
    assert node.leave == 0


def test_a_first_start_ends_after_two_minutes_and_passes_duties_on_until_a_request_confirms_it(disk):
    calls = []
    node = FakeNode()
    before = node.commands
    node.slow = SimpleNamespace(step=calls.append, use=lambda *batch: calls.append(batch))
    watch = trial.Trial(node)
    watch.use("samples", 0, 8)
    watch.step(119_999)
    assert calls == [("samples", 0, 8), 119_999] and node.leave is None
    watch.step(120_000)
    assert node.leave == 0
    (disk / "main.py.new").write_bytes(b"new main")
    assert node.request(Ping()) == [Ack(Ping.type_id, 7)]
    assert node.commands is before and (disk / "main.py").read_bytes() == b"new main"


@pytest.mark.parametrize(
    ("status", "change"),
    [
        (S.NO_KEY, lambda node, patch: setattr(node, "link", object())),
        (S.NO_KEY, lambda node, patch: patch.delitem(update.sys.modules, "sealed")),
        (S.CABLE_ONLY, lambda node, patch: patch.setattr(update.sys, "path", [""])),
        (S.CABLE_ONLY, lambda node, patch: delattr(node, "slow")),
    ],
)
def test_an_update_is_refused_without_a_seal_or_a_fallback(disk, monkeypatch, status, change):
    node = FakeNode()
    change(node, monkeypatch)
    (state,) = node.request(start())
    assert state.status == status and not node.stopped and node.leave is None
    assert (disk / "fw_b" / "drivers" / "stale.py").exists()


def test_the_complete_node_refuses_on_usb_and_knows_no_piece_before_a_start():
    script = [(1.0, request(100, start())), (1.2, request(101, UpdatePiece(0, 0, ((1,),))))]
    sent, _, _ = run(2, script=script)
    (state,) = messages_of(sent, UpdateState)
    assert state.status == S.NO_KEY
    assert [nack.reason for nack in messages_of(sent, Nack)] == [Reason.UNKNOWN_MESSAGE]


def test_the_update_fits_the_heap_that_every_choice_leaves(tmp_path):
    """Loaded beside a driver, which goes when it begins; on a board garbage goes as well."""
    code = (
        FAKES,
        "import wire, framing, binascii, hashlib\nresult = []",
        # The driver with the least heap; as in parts.py, drivers.chip stays in use.
        "from drivers.chip import read_register\nimport drivers.mpu6050",
        "gc.collect()",
        "before = gc.mem_alloc()",
        "from radio import update",
        "gc.collect()",
        "result.append(gc.mem_alloc() - before)",
        "for name in ('radio', 'radio.wire_update'):\n    sys.modules.pop(name)",
        "class Node:\n    def stop(self): pass\nnode = Node()\nnode.commands = node.link = None",
        "node.parts = Node()\none = update.Update(node)\none.stop_sampling()",
        "one._block = bytearray(512)\none._view = memoryview(one._block)",
        "gc.collect()",
        "result.append(gc.mem_alloc() - before)",
        "del one._block, one._view",
        "from radio import switch",
        "gc.collect()",
        "result.append(gc.mem_alloc() - before)",
        "with open('/result', 'w') as file:\n    json.dump(result, file)",
    )
    (loading, running, switching), _ = real_micropython.run(tmp_path, *code)
    print(f"{loading} bytes of heap when loaded, {running} during an update, {switching} at its end")
    assert 1000 < loading < ROOM - 512, "a query is answered beside the sensors"
    assert max(running, switching) < ROOM - 1024, "open files, tags and settings need the rest"
