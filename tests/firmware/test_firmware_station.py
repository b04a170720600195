"""Times at which the Wi-Fi station of the node tries to join, with a fake WLAN interface."""

import sys
import types

import pytest

from fakes.fake_port import PORT_TICKS
from hubodo.emulator.board.network import CONNECT_REFUSED, WifiEnvironment, WlanStation

CONNECTING = {"rp2": 1, "esp32": 1001}
JOIN_S = 2.5


class FakeWlan:
    """A substitute for network.WLAN over the station of the virtual board, in the ticks of the fake port."""

    def __init__(self, port, air):
        self.port = WlanStation(port, air)
        self.zero_us = PORT_TICKS.now_us
        self.connect_times = []
        self.refused = 0
        self.port.activate(True, 0.0)

    @property
    def t(self):
        return (PORT_TICKS.now_us - self.zero_us) * 1e-6

    def config(self, **options):
        if "reconnects" in options:
            if self.port.port == "rp2":
                raise ValueError("unknown config param")
            self.port.set_reconnects(options["reconnects"])

    def connect(self, ssid, password):
        assert (ssid, password) == ("net", "secret")
        if self.port.connect(self.t) == CONNECT_REFUSED:
            self.refused += 1
            raise OSError("Wifi Internal State Error")
        self.connect_times.append(self.t)

    def disconnect(self):
        self.port.disconnect()

    def isconnected(self):
        return self.port.is_connected(self.t)

    def status(self):
        return self.port.status(self.t)


@pytest.fixture
def station(monkeypatch):
    """Return a function of port and network that creates the Station of the firmware and its FakeWlan."""

    def make(port, air):
        network = types.SimpleNamespace(
            STA_IF=0, STAT_CONNECTING=CONNECTING[port], WLAN=types.SimpleNamespace(PM_NONE=0)
        )
        monkeypatch.setitem(sys.modules, "network", network)
        monkeypatch.delitem(sys.modules, "wifi", raising=False)
        import wifi

        wlan = FakeWlan(port, air)
        return wifi.Station(wlan, "net", "secret"), wlan

    yield make
    sys.modules.pop("wifi", None)


def run_station(station, wlan, seconds):
    """Run the station; return for each second whether it was joined."""
    joined_at = []
    for _ in range(seconds):
        joined_at.append(station.is_joined(int(PORT_TICKS.ms())))
        PORT_TICKS.sleep_us(1_000_000)
    return joined_at


@pytest.mark.parametrize("port", ["rp2", "esp32"])
def test_pauses_between_attempts_double_up_to_half_a_minute(station, port):
    node, wlan = station(port, WifiEnvironment(outages=((0, 200),), join_time=JOIN_S))
    joined_at = run_station(node, wlan, 300)
    # A failure is detected at the next full second after JOIN_S; then the pause begins.
    pauses = [round(b - a) - 3 for a, b in zip(wlan.connect_times, wlan.connect_times[1:], strict=False)]
    assert pauses == [1, 2, 4, 8, 16, *(len(pauses) - 5) * [30]] and len(pauses) >= 8
    assert wlan.connect_times[0] < 1 and joined_at.index(True) < 200 + 30 + 3 + 2
    assert all(joined_at[joined_at.index(True) :])


@pytest.mark.parametrize("port", ["rp2", "esp32"])
def test_after_a_loss_the_first_attempt_is_immediate_and_the_pauses_are_reset(station, port):
    """A Pico W reports "joining" after the loss without joining; an ESP32 leaves the retry to the node."""
    node, wlan = station(port, WifiEnvironment(outages=((99.5, 102.8),), join_time=JOIN_S))
    joined_at = run_station(node, wlan, 120)
    assert [round(t) for t in wlan.connect_times] == [0, 100, 104]
    assert joined_at[3:100] == [True] * 97 and joined_at[100:107] == [False] * 7 and all(joined_at[107:])


def test_a_join_that_hangs_is_aborted_after_15_s(station):
    node, wlan = station("rp2", WifiEnvironment(join_time=1e9))
    run_station(node, wlan, 60)
    assert [round(t) for t in wlan.connect_times] == [0, 16, 33, 52]


def test_an_esp32_that_is_already_joining_refuses_once_and_then_connects(station):
    node, wlan = station("esp32", WifiEnvironment(join_time=20.0))
    wlan.port.connect(0.0)
    joined_at = run_station(node, wlan, 45)
    assert wlan.refused == 1 and wlan.connect_times[0] == pytest.approx(1, abs=0.1)
    assert not any(joined_at[:20])
