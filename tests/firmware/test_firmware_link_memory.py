"""Links other than USB send and receive without an allocation, in real MicroPython."""

import pytest
import real_micropython

FAKES = """
import gc, json, micropython, sys, time
sys.path.insert(0, "/")

class Sink:
    taken = 0
    def write(self, raw, at=0, size=0):
        Sink.taken += size
        return size
    def any(self):
        return 0
    def readinto(self, buffer):
        return None
    def setblocking(self, on):
        pass
    def connect(self, address):
        pass

class Wlan:
    PM_NONE = 0
    def __init__(self, interface):
        pass
    def active(self, on):
        pass
    def config(self, **options):
        pass
    def isconnected(self):
        return True

class network:
    STA_IF, STAT_CONNECTING, WLAN = 0, 1, Wlan

class socket:
    AF_INET = SOCK_DGRAM = 2
    def socket(family, kind):
        return Sink()

sys.modules["network"], sys.modules["socket"] = network, socket
import link, framing, outbox
"""

OPEN_LINK = {
    "uart": "import uart\nport = uart.UartLink(Sink(), 921600, 512)",
    "console": "import uart\nport = uart.ConsoleLink()\nport._out = Sink()",
    "udp": "import wifi\n"
    "port = wifi.UdpLink({'ssid': 'a', 'password': 'b', 'host': '10.0.0.7', 'port': 47110})",
}

TURNS = 500

RUN_LOCKED = """
box = outbox.Outbox(4, 1)
def turn():
    box.post(2, 200)
    for _ in range(5):
        time.run(5000)
        port.send(box)
        port.receive()
turn()
def locked():
    before = gc.mem_alloc()
    micropython.heap_lock()
    try:
        for _ in range({turns}):
            turn()
    finally:
        micropython.heap_unlock()
    return gc.mem_alloc() - before
allocated = locked()
with open("/result", "w") as file:
    result = {{"allocated": allocated, "taken": Sink.taken, "dropped": box.dropped}}
    json.dump(result, file)
"""


@pytest.mark.parametrize("kind", OPEN_LINK)
def test_a_link_sends_every_frame_without_an_allocation(tmp_path, kind):
    result, _ = real_micropython.run(tmp_path, FAKES, OPEN_LINK[kind], RUN_LOCKED.format(turns=TURNS))
    assert (result["allocated"], result["dropped"]) == (0, 0)
    assert result["taken"] >= TURNS * 200
