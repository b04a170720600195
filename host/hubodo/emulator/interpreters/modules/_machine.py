"""MicroPython's module machine of the virtual board: I2C, SPI, Pin, ADC, WDT and UART, allocation-free."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import io

import _board

_i2c_to = _board.i2c_to
_result = _board.result
_bus = open("/dev/i2c", "r+b")
_serial = open("/dev/serial", "r+b")
_i2c_read = _bus.readinto
_i2c_write = _bus.write
_serial_to = _board.serial_to
_serial_into = _serial.readinto
_serial_out = _serial.write
_spi = open("/dev/spi", "r+b")
_spi_out = _spi.write
_spi_into = _spi.readinto
_count = _board.count
_pin_set = _board.pin_set
_pin_get = _board.pin_get
_pin_init = _board.pin_init
_adc = _board.adc
_wdt = _board.wdt
_uart_init = _board.uart_init

_AVAILABLE_MASK = 0x3FFF
_WRITABLE_FLAG = 0x4000

_IS_RP2 = _board.platform() == "rp2"
_LED_PIN = 64 if _board.radio() else 25

PWRON_RESET = 1
WDT_RESET = 3
if not _IS_RP2:
    HARD_RESET = 2
    DEEPSLEEP_RESET = 4
    SOFT_RESET = 5


class _ResetRegisters:
    """The object mem32: the reset cause registers; other addresses read 0."""

    def __getitem__(self, address):
        return _board.register("%x" % address)


mem32 = _ResetRegisters()


def unique_id():
    text = _board.unique_id()
    return bytes(int(text[i : i + 2], 16) for i in range(0, len(text), 2))


def reset_cause():
    return _board.reset_cause()


def reset():
    _board.reset()


def soft_reset():
    raise SystemExit


def freq(hz=None):
    return _board.frequency()


def idle():
    pass


def lightsleep(ms=None):
    """Sleep for `ms`, or until a pin ends it; without `ms` nothing else does.

    rp2: the edge of a pin with a handler. esp32: the high level of the pin of `esp32.wake_on_ext0`.
    """
    is_esp32 = _board.platform() == "esp32"
    pin = Pin._wake if is_esp32 else Pin._edges
    if is_esp32 and pin and _pin_get(pin - 1):
        return
    while ms is None or ms > 0:
        left = _board.light_sleep(pin, 60000 if ms is None else min(ms, 60000))
        if pin and left:
            return
        if ms is not None:
            ms -= 60000


def disable_irq():
    return 0


def enable_irq(state):
    pass


class Pin:
    """A GPIO pin."""

    IN = 0
    OUT = 1
    OPEN_DRAIN = 2
    PULL_UP = 1
    PULL_DOWN = 2
    IRQ_RISING = 8
    IRQ_FALLING = 4
    _edges = 0
    """Number of the pin with a handler, plus one; only one has a handler here."""
    _wake = 0
    """Number of the pin that ends a sleep of an ESP32, plus one."""

    def __init__(self, id, mode=-1, pull=-1, value=None):
        self._id = id._id if isinstance(id, Pin) else _pin_number(id)
        if mode >= 0:
            self.init(mode, pull, value=value)

    def init(self, mode=-1, pull=-1, value=None):
        if value is not None:
            _pin_set(self._id, 1 if value else 0)
        _pin_init(self._id, mode, -1 if pull is None else pull)

    def value(self, level=None):
        if level is None:
            return _pin_get(self._id)
        _pin_set(self._id, 1 if level else 0)
        return None

    def __call__(self, level=None):
        return self.value(level)

    def irq(self, handler=None, trigger=IRQ_FALLING | IRQ_RISING):
        """Let a rising edge of this pin end `lightsleep`; the handler is not called."""
        Pin._edges = self._id + 1 if handler is not None and trigger & Pin.IRQ_RISING else 0

    def on(self):
        _pin_set(self._id, 1)

    def off(self):
        _pin_set(self._id, 0)

    high = on
    low = off

    def toggle(self):
        _pin_set(self._id, 1 - _pin_get(self._id))


def _pin_number(id):
    """Return the GPIO number of a pin name; raise ValueError if it does not exist."""
    if id == "LED":
        return _LED_PIN
    number = id if isinstance(id, int) else int(id[2:])
    if not _board.pin_exists(number):
        raise ValueError("invalid pin")
    return number


def _check_pin(valid, function):
    """Raise ValueError unless a pin is valid for its function."""
    if not valid:
        raise ValueError("bad {} pin".format(function))


def _number(pin, default):
    """Return the GPIO number of a pin, or a default for None."""
    if pin is None:
        return default
    return pin._id if isinstance(pin, Pin) else _pin_number(pin)


class I2C:
    """An I2C controller."""

    _HARDWARE = True

    def __init__(self, id=0, *, scl=None, sda=None, freq=400000, timeout=50000):
        if not 0 <= id < _board.i2c_count():
            raise ValueError("I2C({}) doesn't exist".format(id))
        if _IS_RP2 and self._HARDWARE:
            # ports/rp2/machine_i2c.c: SDA on even pins, SCL on odd, the two units in turn.
            _check_pin(scl is None or _number(scl, 1) & 3 == 1 + 2 * id, "SCL")
            _check_pin(sda is None or _number(sda, 0) & 3 == 2 * id, "SDA")
        self._id = id
        self._mem = id << 1
        self._plain = id << 1 | 1
        _board.i2c_init(id, freq, _number(scl, -1), _number(sda, -1))

    def init(self, *, scl=None, sda=None, freq=400000):
        _board.i2c_init(self._id, freq, _number(scl, -1), _number(sda, -1))

    def deinit(self):
        pass

    def readfrom_mem_into(self, addr, memaddr, buf, *, addrsize=8):
        _i2c_to(self._mem, addr, memaddr, addrsize >> 3)
        _i2c_read(buf)
        if _result() < 0:
            raise OSError(-_result())

    def writeto_mem(self, addr, memaddr, buf, *, addrsize=8):
        _i2c_to(self._mem, addr, memaddr, addrsize >> 3)
        _i2c_write(buf)
        if _result() < 0:
            raise OSError(-_result())

    def readfrom_mem(self, addr, memaddr, nbytes, *, addrsize=8):
        buf = bytearray(nbytes)
        self.readfrom_mem_into(addr, memaddr, buf, addrsize=addrsize)
        return bytes(buf)

    def readfrom_into(self, addr, buf, stop=True):
        _i2c_to(self._plain, addr, 0, 0)
        _i2c_read(buf)
        if _result() < 0:
            raise OSError(-_result())

    def readfrom(self, addr, nbytes, stop=True):
        buf = bytearray(nbytes)
        self.readfrom_into(addr, buf)
        return bytes(buf)

    def writeto(self, addr, buf, stop=True):
        _i2c_to(self._plain, addr, 0, 0)
        _i2c_write(buf)
        if _result() < 0:
            raise OSError(-_result())
        return len(buf)

    def scan(self):
        return [ord(c) for c in _board.i2c_scan(self._id)]


class SPI:
    """An SPI controller, one transfer per call; the caller drives the chip select."""

    MSB = 0

    def __init__(self, id, baudrate=1000000, *, polarity=0, phase=0, sck=None, mosi=None, miso=None):
        if _IS_RP2:
            # ports/rp2/machine_spi.c: pin n has function n modulo 4, of unit n // 8 modulo 2.
            for function, remainder, pin in (("SCK", 2, sck), ("MOSI", 3, mosi), ("MISO", 0, miso)):
                if pin is not None:
                    number = _number(pin, 0)
                    _check_pin(number & 3 == remainder and (number & 8) >> 3 == id, function)
        self._id = id

    def init(self, baudrate=1000000):
        pass

    def write_readinto(self, out, into):
        _board.spi_to(self._id)
        _spi_out(out)
        _spi_into(into)

    def write(self, out):
        _board.spi_to(self._id)
        _spi_out(out)

    def readinto(self, into, write=0):
        for i in range(len(into)):
            into[i] = write
        self.write_readinto(into, into)


class SoftI2C(I2C):
    """A software I2C controller on any pins."""

    _HARDWARE = False

    def __init__(self, scl, sda, *, freq=400000, timeout=50000):
        super().__init__(0, scl=scl, sda=sda, freq=freq)


class ADC:
    """An ADC channel; on an ESP32 its default range is 0.95 V (ATTN_0DB)."""

    CORE_TEMP = 4
    ATTN_0DB = 0
    ATTN_11DB = 3

    def __init__(self, id):
        self._id = id._id if isinstance(id, Pin) else id
        on_pin = _board.pin_measures(self._id)
        if not (on_pin or (_IS_RP2 and isinstance(id, int) and 0 <= id <= 4)):
            raise ValueError("Pin doesn't have ADC capabilities" if _IS_RP2 else "invalid pin")
        if not _IS_RP2:
            self._range_uv = 950000
            self.read_uv = self._read_uv
            self.atten = self._set_atten

    def read_u16(self):
        return _adc(self._id) if _IS_RP2 else self._read_uv() // 100 * 65535 // (self._range_uv // 100)

    def _read_uv(self):
        return min(_adc(self._id) * 5035 // 100, self._range_uv)

    def _set_atten(self, atten):
        self._range_uv = 3100000 if atten == self.ATTN_11DB else 950000


class WDT:
    """The watchdog timer."""

    def __init__(self, id=0, timeout=5000):
        if _IS_RP2 and not 1 <= timeout <= 8388:
            raise ValueError("timeout exceeds 8388")
        _wdt(1, timeout)

    def feed(self):
        _wdt(0, 0)


class UART(io.IOBase):
    """A UART."""

    def __init__(self, id, baudrate=115200, **options):
        if not 0 <= id < _board.uart_count():
            raise ValueError("UART({}) doesn't exist".format(id))
        if _IS_RP2:
            # ports/rp2/machine_uart.c: TX on every fourth pin, RX behind it, the two units in eights.
            for function, remainder in (("tx", 0), ("rx", 1)):
                pin = options.get(function)
                if pin is not None:
                    number = _number(pin, 0)
                    _check_pin(number & 3 == remainder and (number + 4 & 8) >> 3 == id, function.upper())
        self._port = id + 1
        self._timeout = 0
        self._buffers = (256, 256)
        self.init(baudrate, **options)

    def init(
        self, baudrate=115200, bits=8, parity=None, stop=1, *, timeout=None, txbuf=None, rxbuf=None, **pins
    ):
        # As in ports/rp2/machine_uart.c, what is not given stays as it is.
        self._timeout = self._timeout if timeout is None else timeout
        self._buffers = (txbuf or self._buffers[0], rxbuf or self._buffers[1])
        _uart_init(self._port, baudrate, *self._buffers)

    def deinit(self):
        pass

    def any(self):
        return _count(self._port) & _AVAILABLE_MASK

    def write(self, buf, at=None, size=None):
        _serial_to(self._port, 0)
        if size is not None:
            return _serial_out(buf, at, size) or None
        return (_serial_out(buf) if at is None else _serial_out(buf, at)) or None

    def readinto(self, buf, nbytes=None):
        _serial_to(self._port, self._timeout)
        if nbytes is not None:
            buf = memoryview(buf)[:nbytes]
        return _serial_into(buf) or None

    def read(self, nbytes=None):
        n = self.any() if nbytes is None else nbytes
        if not n:
            return None
        buf = bytearray(n)
        got = self.readinto(buf)
        return bytes(buf[:got]) if got else None

    def ioctl(self, request, arg):
        if request == 3:
            count = _count(self._port)
            return arg & ((1 if count & _AVAILABLE_MASK else 0) | (4 if count & _WRITABLE_FLAG else 0))
        return 0
