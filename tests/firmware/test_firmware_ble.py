"""The Bluetooth link of the node: heap in use in real MicroPython, its service, and its refusals."""

import ast

import pytest
import real_micropython

from hubowire import ble

FAKE_RADIO = """
import gc, json, micropython, sys, time
sys.path.insert(0, "/")

class Radio:
    notified, advertised = [], 0
    def active(self, on):
        pass
    def config(self, **options):
        pass
    def irq(self, handler):
        Radio.handler = handler
    def gatts_register_services(self, services):
        return ((1, 2, 3),)
    def gatts_set_buffer(self, handle, size):
        pass
    def gatts_read(self, handle):
        return Radio.written
    def gatts_notify(self, connection, handle, data):
        if len(Radio.notified) >= Radio.room:
            raise OSError(12)
        Radio.notified.append(bytes(data))
    def gap_advertise(self, interval, adv_data, resp_data):
        Radio.advertised += 1
    def gap_disconnect(self, connection):
        Radio.handler(2, (connection, 0))

class bluetooth:
    BLE = Radio
    def UUID(text):
        return bytes(16)

def write(handle, data):
    Radio.written = data
    Radio.handler(3, (7, handle))

Radio.room = 1000
sys.modules["bluetooth"] = bluetooth
import machine
machine.unique_id = lambda: bytes(8)
import link, framing, outbox
"""
OPEN = """
# The interpreter's table of names has just grown, and does not do so within the measurement.
class Names:
    pass
for k in range(60):
    setattr(Names, "n%d" % k, 0)
gc.collect()
before = gc.mem_alloc()
import ble
port = ble.BleLink({{"node_id": 1}})
{seal}
gc.collect()
used = gc.mem_alloc() - before
"""
SEAL = "import sealed\nport = sealed.SealedLink(port, '00' * 32)"
RUN = """
box = outbox.Outbox(24, 1)
def send(count):
    for _ in range(count):
        box.post(2, 100)
        port.send(box)
send(2)
steps = [len(Radio.notified)]
Radio.handler(1, (7, 0))
send(1)
write(3, b"\\0\\0")
send(1)
steps.append(len(Radio.notified))
Radio.handler(21, (7, 247))
send(20)
steps.append(len(Radio.notified))
write(3, b"\\x0d\\0")
send(1)
steps.append(len(Radio.notified))
write(3, b"\\4\\0")
send(1)
steps.append(len(Radio.notified))
Radio.room = steps[-1]
write(3, b"\\x0c\\0")
send(1)
refused = len(Radio.notified), box.dropped
for _ in range(10):
    write(2, bytes(5))
damaged = port.reader.damaged
time.run(6000000)
port.step()
steps.append(Radio.advertised)
"""
WRITE = """
with open("/result", "w") as file:
    json.dump({"used": used, "steps": steps, "refused": refused, "damaged": damaged}, file)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    result, _ = real_micropython.run(
        tmp_path_factory.mktemp("ble"), FAKE_RADIO, OPEN.format(seal=""), RUN, WRITE
    )
    return result


def test_frames_wait_for_a_subscribed_host_with_room_and_at_most_a_window_is_on_its_way(run):
    not_connected, small_mtu, window, too_many, reported, advertised = run["steps"]
    assert (not_connected, small_mtu) == (0, 0)
    assert window == ble.WINDOW
    assert too_many == window, "a report of more than was sent is ignored"
    assert reported == window + 4
    assert run["refused"][0] == reported, "the radio refused: the frame stays queued"
    assert run["damaged"] == 2, "requests beyond eight are dropped and counted"
    assert advertised == 2, (
        "a host that reports nothing for 5 s is disconnected, and the node advertised again"
    )


def test_the_node_has_the_service_of_the_host():
    tree = ast.parse((real_micropython.ROOT / "firmware" / "ble.py").read_text())
    values = {
        node.targets[0].id: node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        if isinstance(node.targets[0], ast.Name)
    }
    uuids = [ast.literal_eval(values["_SERVICE"]) % (0x8606 + k) for k in range(4)]
    assert uuids == [ble.SERVICE_UUID, ble.FRAMES_UUID, ble.REQUESTS_UUID, ble.REPORTS_UUID]
    assert values["_WINDOW"].args[0].value == ble.WINDOW


@pytest.mark.parametrize(("seal", "limit"), [("", 13_312), (SEAL, 21_504)])
def test_the_link_needs_less_heap_than_wifi_does(tmp_path, seal, limit):
    """Wi-Fi needs 14,272 bytes without a key, and 25,152 with one."""
    pieces = FAKE_RADIO, OPEN.format(seal=seal), "steps = refused = damaged = 0", WRITE
    result, _ = real_micropython.run(tmp_path, *pieces)
    print(f"Bluetooth {'with a key' if seal else 'without a key'}: {result['used']} bytes of heap")
    assert result["used"] < limit


@pytest.mark.parametrize("free", [8191, 8192])
def test_settings_that_leave_too_little_heap_are_refused_with_the_reason(tmp_path, free):
    fake = f"""
class Gc:
    collect = gc.collect
    mem_free = lambda: {free}
ble.gc = Gc
steps = []
try:
    port.step()
except MemoryError as error:
    steps.append(str(error))
refused = damaged = 0
"""
    result, _ = real_micropython.run(tmp_path, FAKE_RADIO, OPEN.format(seal=""), fake, WRITE)
    assert len(result["steps"]) == (free < 8192)
    assert all("filter_kind" in text for text in result["steps"])
