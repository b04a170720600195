"""UDP over Wi-Fi: one datagram per frame to one host; the network is joined again after each loss.

Nothing here blocks: the state of a join is polled, and the name of the host is resolved by `name.py`, as a
port's getaddrinfo blocks for 7 to 14 s without an answer.
"""

import socket
from time import ticks_add, ticks_diff, ticks_ms

import network
from link import _write
from micropython import const
from name import Name
from packets import PacketLink

_MAX_DATAGRAM = const(272)
"""Bytes of the largest frame and of its seal."""
_JOIN_MS = const(15000)
_PAUSE_MS = const(1000)
_LONGEST_PAUSE_MS = const(30000)
_FAILING_MS = const(5000)
_RESOLVE_MS = const(30000)
_RETRY_MS = const(50)


class Station:
    """Keeps a WLAN interface joined to one network; attempts are 1, 2, 4 .. 30 s apart."""

    def __init__(self, wlan, ssid, password):
        self._wlan = wlan
        self._ssid = ssid
        self._password = password
        self._joining = False
        self._pause_ms = _PAUSE_MS
        self._since_ms = self._again_ms = ticks_ms()
        for option in ({"reconnects": 0}, {"pm": network.WLAN.PM_NONE}):
            try:
                wlan.config(**option)
            except (OSError, TypeError, ValueError):
                # A port may lack an option.
                pass

    def is_joined(self, ms):
        """Return True if the network is joined; otherwise advance the attempt to join it."""
        if self._wlan.isconnected():
            self._joining = False
            self._pause_ms = _PAUSE_MS
            self._again_ms = ms
            return True
        if self._joining:
            # The status of a Pico W stays "joining" after a loss; an ESP32 reports the failure.
            step = self._wlan.status() - network.STAT_CONNECTING
            if not 0 <= step <= 1 or ticks_diff(ms, self._since_ms) >= _JOIN_MS:
                self._give_up(ms)
        elif ticks_diff(ms, self._again_ms) >= 0:
            self._connect(ms)
        return False

    def _connect(self, ms):
        try:
            self._wlan.connect(self._ssid, self._password)
            self._joining = True
            self._since_ms = ms
        except OSError:
            # An ESP32 that is already joining refuses.
            self._give_up(ms)

    def _give_up(self, ms):
        self._joining = False
        self._again_ms = ticks_add(ms, self._pause_ms)
        self._pause_ms = min(2 * self._pause_ms, _LONGEST_PAUSE_MS)
        try:
            self._wlan.disconnect()
        except OSError:
            pass


class UdpLink(PacketLink):
    """A link by UDP; frames wait without network or host. `step` must be called every second."""

    packet_bytes = _MAX_DATAGRAM

    def __init__(self, settings):
        super().__init__(_MAX_DATAGRAM)
        wlan = network.WLAN(network.STA_IF)
        wlan.active(True)
        self._station = Station(wlan, settings["ssid"], settings["password"])
        self._name = Name(wlan, settings["host"])
        self._port = settings["port"]
        self._socket = self._address = None
        self._failing = False
        self._failing_ms = self._retry_ms = self._known_ms = ticks_ms()
        self.step()

    def step(self):
        ms = ticks_ms()
        if not self._station.is_joined(ms):
            self.close()
        else:
            if self._failing and ticks_diff(ms, self._failing_ms) >= _FAILING_MS:
                self.close()
            if self._socket is None or ticks_diff(ms, self._known_ms) >= _RESOLVE_MS:
                self._look_up(ms)

    def close(self):
        self._name.cancel()
        self._failing = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _look_up(self, ms):
        """Resolve the host and connect to it; not called while datagrams of the host arrive."""
        address = self._name.address()
        if address is None:
            return
        self._known_ms = ms
        if self._socket is not None:
            if address == self._address:
                return
            self._socket.close()
            self._socket = None
        self._address = address
        try:
            udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            udp.setblocking(False)
            udp.connect((address, self._port))
            self._socket = udp
        except OSError:
            # Out of memory, or the network is gone: repeated in a second.
            pass

    def is_open(self):
        return self._socket is not None

    def send_packet(self, raw, at, size):
        if self._socket is None or (self._failing and ticks_diff(ticks_ms(), self._retry_ms) < 0):
            return 0
        try:
            accepted = _write(self._socket, raw, at, size)
            self._failing = False
            return accepted
        except OSError:
            # Full buffers or no route: the frame stays queued. Retries are spaced, as each error allocates.
            self._retry_ms = ticks_add(ticks_ms(), _RETRY_MS)
            if not self._failing:
                self._failing = True
                self._failing_ms = ticks_ms()
            return 0

    def receive_packet(self, raw):
        if self._socket is None:
            return 0
        try:
            size = self._socket.readinto(raw) or 0
        except OSError:
            return 0
        if size:
            self._known_ms = ticks_ms()
        return size
