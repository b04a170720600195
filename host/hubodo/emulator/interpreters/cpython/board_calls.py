"""Calls to the board, and its clock, for firmware that runs on CPython."""

# Runs in the interpreter of a board, outside the package: without type annotations.
# mypy: ignore-errors

import json
import os
import struct
import sys
import time as real_time

CONFIG = json.loads(sys.argv[1])
OP = CONFIG["ops"]
REQUEST_FD, RESPONSE_FD = CONFIG["pipes"]
STEPPED, PACED = CONFIG["stepped"], CONFIG["paced"]
REQUEST = struct.Struct("<BxhHHd")
RESPONSE = struct.Struct("<hBBIdd")
FLAG_INTERRUPT = 4
TICKS_PERIOD = 1 << 30
NAP_NS = 10e6


class BoardCalls:
    """Calls of runner.mjs in Python; modules in MicroPython style import it as `_board`."""

    def __init__(self):
        self.t = CONFIG["t_ns"]
        self.flags = 0
        self.interrupt_char = 3
        self.booting, self.interrupted = True, False
        self.contact, self.quiet = -1e18, 0.0
        self.rate = 1 + CONFIG["clock_ppm"] * 1e-6
        self.ticks_start = CONFIG["ticks_start_us"]
        self.t0 = int(CONFIG["t0_ns"])
        self.status = 0
        self.transfer_target = (0, 0, 0, 1)
        self.port, self.timeout = 0, 0
        self.socket, self.peer = 0, bytes(6)
        self.spi_unit = 0

    def now(self):
        """Return the true time, ns since power-on."""
        return self.t if STEPPED else real_time.monotonic_ns() - self.t0

    def pace(self, max_lead_ns):
        """Sleep while virtual time is ahead of wall time by more than `max_lead_ns` ns."""
        ahead = self.t - (real_time.monotonic_ns() - self.t0) / CONFIG["pace"] if PACED else 0
        if ahead > max_lead_ns:
            real_time.sleep(ahead * CONFIG["pace"] / 1e9)

    def advance_time(self, ns):
        """Advance virtual time by `ns`."""
        if STEPPED:
            self.t += ns
            self.pace(2e6)

    def wait_until(self, t):
        """Wait until t, ns."""
        if STEPPED:
            self.t = max(self.t, t)
            self.pace(150e3)
            return
        remaining_ns = t - self.now()
        while remaining_ns > 0:
            if remaining_ns > 70e3:
                real_time.sleep((remaining_ns - 35e3) / 1e9)
            remaining_ns = t - self.now()

    def ask(self, op, argument=0, payload=b""):
        """Send a request to the board; return the status and the payload of its reply."""
        os.write(
            REQUEST_FD,
            REQUEST.pack(OP[op], self.interrupt_char, argument, len(payload), self.now()) + payload,
        )
        data = os.read(RESPONSE_FD, 1 << 17)
        while len(data) < RESPONSE.size or len(data) < RESPONSE.size + RESPONSE.unpack_from(data)[3]:
            chunk = os.read(RESPONSE_FD, 1 << 17)
            if not chunk:
                os._exit(1)
            data += chunk
        status, self.flags, _, n, t, self.quiet = RESPONSE.unpack_from(data)
        self.wait_until(t)
        self.advance_time(CONFIG["call_cost_ns"])
        self.contact = self.now()
        if self.flags & FLAG_INTERRUPT:
            self.interrupted = True
        self.check_interrupt()
        return status, data[RESPONSE.size : RESPONSE.size + n]

    def check_interrupt(self):
        """Raise KeyboardInterrupt if ctrl-C is pending; one before the user's code is kept for it."""
        if self.interrupted and not self.booting:
            self.interrupted = False
            raise KeyboardInterrupt

    def stale(self, ns):
        """Return True if the flags of the board may be older than `ns`."""
        now = self.now()
        return now - self.contact >= ns and now >= self.quiet

    def fresh_flags(self):
        """Return the flags of the board, refreshed if stale."""
        if self.stale(CONFIG["refresh_ns"]):
            self.ask("PING")
        else:
            self.advance_time(CONFIG["tick_cost_ns"])
        return self.flags

    def device_us(self):
        """Return the time of the device clock, µs, without wrap-around."""
        return self.ticks_start + (self.now() - CONFIG["t_boot_ns"]) * self.rate / 1000

    def ticks_us(self):
        self.advance_time(CONFIG["tick_cost_ns"])
        return int(self.device_us()) % TICKS_PERIOD

    def ticks_ms(self):
        self.advance_time(CONFIG["tick_cost_ns"])
        return int(self.device_us() / 1000) % TICKS_PERIOD

    def sleep_us(self, us):
        """Sleep for `us` of the device clock; ctrl-C interrupts it."""
        self.check_interrupt()
        end = self.now() + us * 1000 / self.rate
        while True:
            self.wait_until(min(end, self.now() + NAP_NS))
            if self.stale(NAP_NS):
                self.ask("PING")
            if self.now() >= end:
                return

    def sleep_ms(self, ms):
        self.sleep_us(ms * 1000)

    def i2c_to(self, bus_mode, to, memory, size):
        """Set bus, address and register of the next transfer."""
        self.transfer_target = (bus_mode, to, memory, size)
        self.status = 0

    def result(self):
        return self.status

    def i2c_init(self, bus, frequency, scl, sda):
        return self.ask("I2C_INIT", bus, struct.pack("<Ibb", frequency, scl, sda))[0]

    def i2c_scan(self, bus):
        return self.ask("I2C_SCAN", bus)[1].decode("latin1")

    def pin_init(self, pin, mode, pull):
        return self.ask("PIN_INIT", pin, struct.pack("<bb", mode, pull))[0]

    def pin_set(self, pin, level):
        return self.ask("PIN_SET", pin, bytes([level]))[0]

    def pin_get(self, pin):
        return self.ask("PIN_GET", pin)[0]

    def light_sleep(self, pin, ms):
        began = self.now()
        woken = self.ask("LIGHT_SLEEP", pin, struct.pack("<I", ms))[0]
        self.ticks_start += (self.now() - began) * CONFIG["sleep_ppm"] * 1e-9
        return woken

    def adc(self, channel):
        return struct.unpack("<H", self.ask("ADC_READ", channel)[1])[0]

    def wdt(self, start, ms):
        return self.ask("WDT", start, struct.pack("<I", ms))[0]

    def reset(self):
        self.ask("RESET")

    def serial_to(self, port, timeout_ms):
        self.port, self.timeout = port, timeout_ms

    def count(self, port):
        return self.ask("COUNT", port)[0]

    def spi_to(self, unit):
        self.spi_unit = unit

    def uart_init(self, port, baud, send_buffer, receive_buffer):
        return self.ask("UART_INIT", port, struct.pack("<IHH", baud, send_buffer, receive_buffer))[0]

    def wlan(self, command):
        return self.ask("WLAN", command)[0]

    def udp_open(self):
        return self.ask("UDP_OPEN")[0]

    def udp_bind(self, handle, port):
        return self.ask("UDP_BIND", handle, struct.pack("<H", port))[0]

    def udp_close(self, handle):
        return self.ask("UDP_CLOSE", handle)[0]

    def udp_destination(self, handle, high, low, port):
        self.socket, self.status = handle, 0
        self.peer = struct.pack(">HH", high, low) + struct.pack("<H", port)

    def udp_from(self, handle, timeout_ms):
        self.socket, self.timeout, self.status = handle, timeout_ms, 0

    def udp_peer(self, k):
        return self.peer[k] if k < 4 else struct.unpack_from("<H", self.peer, 4)[0]

    def unique_id(self):
        return CONFIG["unique_id"]

    def reset_cause(self):
        return CONFIG["reset_cause"]

    def register(self, address):
        return CONFIG["registers"].get(address, 0)

    def machine_name(self):
        return CONFIG["machine"]

    def platform(self):
        return CONFIG["platform"]

    def radio(self):
        return CONFIG["radio"]

    def pin_exists(self, pin):
        return pin in CONFIG["pins"]

    def pin_measures(self, pin):
        return pin in CONFIG["adc_pins"]

    def i2c_count(self):
        return CONFIG["i2c_count"]

    def uart_count(self):
        return CONFIG["uart_count"]

    def frequency(self):
        return CONFIG["frequency_hz"]

    def heap_bytes(self):
        return CONFIG["heap_bytes"]

    def write_port(self, port, data):
        sent = 0
        while sent < len(data):
            sent += self.ask("WRITE", port, bytes(data[sent : sent + 32768]))[0]
        return sent

    def read_port(self, port, most, timeout_ms):
        return self.ask("READ", port, struct.pack("<Ii", most, timeout_ms))[1]


board = BoardCalls()
