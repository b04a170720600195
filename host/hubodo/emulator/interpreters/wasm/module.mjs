// The module `_board`, on which machine, network and time of the board are built: one function per call.
import { HEADER } from "../pipe.mjs";
import { linux } from "./errno.mjs";
import { FLASH } from "./flash.mjs";

export const TICKS_MASK = 0x3fffffff;
const FEEDS = 64;

function time(board, clock, config) {
  const ticks = (now) => {
    clock.spend(config.tick_cost_ns);
    return now() % (TICKS_MASK + 1) | 0;
  };
  return {
    ticks_us: () => ticks(() => clock.deviceUs()),
    ticks_ms: () => ticks(() => clock.deviceUs() / 1000),
    sleep_us: (us) => board.sleep((us * 1000) / clock.rate),
    sleep_ms: (ms) => board.sleep((ms * 1e6) / clock.rate),
    wait_input: (ms) => board.waitInput(ms),
  };
}

function machine(board, clock, config) {
  const { op, request, view } = board;
  let lastFed = -1e18, timeoutNs = 0;
  return {
    i2c_init(bus, frequency, scl, sda) {
      view.setUint32(HEADER, frequency, true);
      view.setInt8(HEADER + 4, scl);
      view.setInt8(HEADER + 5, sda);
      return board.ask(op.I2C_INIT, bus, 6);
    },
    i2c_scan: (bus) => (board.ask(op.I2C_SCAN, bus) < 0 ? "" : Buffer.from(board.payload).toString("latin1")),
    pin_init(pin, pinMode, pull) {
      request[HEADER] = pinMode;
      view.setInt8(HEADER + 1, pull);
      return board.ask(op.PIN_INIT, pin, 2);
    },
    pin_set(pin, level) {
      request[HEADER] = level;
      return board.ask(op.PIN_SET, pin, 1);
    },
    pin_get: (pin) => board.ask(op.PIN_GET, pin),
    light_sleep(pin, ms) {
      view.setUint32(HEADER, ms, true);
      const began = clock.now(), woken = board.ask(op.LIGHT_SLEEP, pin, 4);
      clock.shift((clock.now() - began) * config.sleep_ppm * 1e-9);
      return woken;
    },
    adc(channel) {
      board.ask(op.ADC_READ, channel);
      return board.payload.readUInt16LE(0);
    },
    // A watchdog feed is reported to the board at most a few dozen times per timeout.
    wdt(start, ms) {
      if (start) timeoutNs = ms * 1e6;
      else if (clock.now() - lastFed < timeoutNs / FEEDS) {
        clock.spend(config.tick_cost_ns);
        return 0;
      }
      lastFed = clock.now();
      view.setUint32(HEADER, ms, true);
      return board.ask(op.WDT, start, 4);
    },
    reset: () => board.ask(op.RESET),
    count: (from) => board.ask(op.COUNT, from),
    uart_init(to, baud, toSend, toRead) {
      view.setUint32(HEADER, baud, true);
      view.setUint16(HEADER + 4, toSend, true);
      view.setUint16(HEADER + 6, toRead, true);
      return board.ask(op.UART_INIT, to, 8);
    },
  };
}

function network(board) {
  const { op, view } = board;
  return {
    wlan: (what) => board.ask(op.WLAN, what),
    udp_open: () => board.ask(op.UDP_OPEN),
    udp_bind(handle, local) {
      view.setUint16(HEADER, local, true);
      return board.ask(op.UDP_BIND, handle, 2);
    },
    udp_close: (handle) => board.ask(op.UDP_CLOSE, handle),
  };
}

function settings(config) {
  return {
    unique_id: () => config.unique_id,
    reset_cause: () => config.reset_cause,
    register: (address) => config.registers[address] ?? 0,
    machine_name: () => config.machine,
    platform: () => config.platform,
    radio: () => config.radio,
    pin_exists: (pin) => config.pins.includes(pin),
    pin_measures: (pin) => config.adc_pins.includes(pin),
    i2c_count: () => config.i2c_count,
    uart_count: () => config.uart_count,
    frequency: () => config.frequency_hz,
    heap_bytes: () => config.heap_bytes,
  };
}

export function boardModule(board, clock, config, FS) {
  return {
    ...time(board, clock, config),
    ...machine(board, clock, config),
    ...network(board),
    ...settings(config),
    rename(from, to) {
      try {
        FS.rename(FLASH + from, FLASH + to);
        return 0;
      } catch (error) {
        return error.errno === undefined ? 5 : linux(error.errno);
      }
    },
  };
}
