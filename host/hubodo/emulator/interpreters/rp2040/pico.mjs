// The machine: an RP2040 with flash chip, bus and USB; flash and scratch registers survive resets.
import { ConsoleLogger, LogLevel, RP2040 } from "rp2040js";
import { I2cController } from "./i2c.mjs";
import { Pins } from "./pins.mjs";
import { SpiController } from "./spi.mjs";
import { FastCore } from "./thumb.mjs";
import { UsbHost } from "./usb.mjs";
import { XipCache } from "./xip_cache.mjs";

export const CLOCK_HZ = 125e6;
const FLASH = 0x10000000, WATCHDOG = 0x40058;
const ENTRY_CYCLES = 15; // interrupt latency, Cortex-M0+ manual, 3.1
const ASLEEP_NS = 1e6;

export class Pico {
  /**
   * flash: a Flash; bootrom: Buffer; missCycles: of the XIP cache, 0 = it never misses.
   * rate: device seconds to a true one; ticksStartUs: of its timer at power-on.
   * `line` is given by `connect`, which switches it on.
   */
  constructor({ flash, bootrom, missCycles, rate, ticksStartUs }) {
    Object.assign(this, { flash, bootrom, missCycles, rate });
    this.cycleNs = 1e9 / CLOCK_HZ;
    this.resets = 0;
    this.asleep = 0; // ns spent in WFI and WFE
    this.cacheMisses = 0; // before the last reset
    this.hooks = new Map(); // pc → functions (core) called before the instruction there
    this.waits = new Map(); // pc of a busy-wait loop → (core) => device µs at which it ends
    this.onReset = () => {};
    this._reason = 0;
    this._scratch = null;
    this._ticksStartNs = ticksStartUs * 1000;
    this._bootedAt = 0; // true ns
  }

  /** Switches it on. */
  connect(line) {
    this.line = line;
    this._boot(this._ticksStartNs);
  }

  /** True time since power-on, ns. */
  get now() {
    return this._bootedAt + (this.clock.nanos - this._zero) / this.rate;
  }

  /** Cycles of the processor since power-on, sleep included. */
  get cycles() {
    return (this.now * this.rate) / this.cycleNs;
  }

  get misses() {
    return this.cacheMisses + (this.cache?.misses ?? 0);
  }

  _boot(ticksNs) {
    const mcu = (this.mcu = new RP2040());
    this.core = mcu.core;
    this.clock = mcu.clock;
    this.clock.nanosCounter = this._zero = ticksNs;
    mcu.logger = new ConsoleLogger(LogLevel.Error, false);
    const rom = this.bootrom;
    mcu.loadBootrom(new Uint32Array(rom.buffer.slice(rom.byteOffset, rom.byteOffset + rom.length)));
    this.flash.plug(mcu);
    const watchdog = mcu.peripherals[WATCHDOG];
    watchdog.reason = this._reason;
    if (this._scratch) watchdog.scratchData.set(this._scratch);
    watchdog.onWatchdogTrigger = () => {
      mcu.stopped = true;
      // Otherwise its alarm would fire again immediately, forever.
      watchdog.alarm.enable = false;
    };
    this.cache = this.missCycles ? new XipCache(this.missCycles) : null;
    this.fast = new FastCore(mcu, CLOCK_HZ, this.cache);
    this.fast.onMark = (pc) => this._marked(pc);
    const { eraseAt, programAt } = this.flash;
    for (const pc of [eraseAt, programAt, ...this.hooks.keys(), ...this.waits.keys()]) this.fast.mark(pc, true);
    this._busyUntil = 0;
    const pins = new Pins(mcu, this.line);
    for (const number of [0, 1]) {
      new I2cController(mcu, number, this.line, pins);
      new SpiController(mcu, number, this.line, pins);
    }
    this.usb = new UsbHost(mcu, this.line);
    this.core.PC = FLASH;
  }

  _reset() {
    const watchdog = this.mcu.peripherals[WATCHDOG];
    this._reason = watchdog.reason;
    this._scratch = Uint32Array.from(watchdog.scratchData);
    this.cacheMisses = this.misses;
    this.resets++;
    this.onReset(this._reason);
    this._bootedAt = this.now;
    this._boot(0);
  }

  /** Calls `hook(core)` before the instruction at `pc`; returns a function that removes it. */
  hook(pc, hook) {
    const known = this.hooks.get(pc);
    if (known) known.push(hook);
    else this.hooks.set(pc, [hook]);
    this.fast?.mark(pc, true);
    return () => {
      const left = this.hooks.get(pc).filter((it) => it !== hook);
      if (left.length) this.hooks.set(pc, left);
      else {
        this.hooks.delete(pc);
        this.fast.mark(pc, this.waits.has(pc));
      }
    };
  }

  // Runs before a marked instruction; returns the cycles that pass before it.
  _marked(pc) {
    if (pc === this.flash.eraseAt || pc === this.flash.programAt) {
      this._busyUntil = this.clock.nanos + this.flash.serve(this.core);
      this.cache?.flush();
      this.fast.yield();
      return 0;
    }
    const hooks = this.hooks.get(pc);
    if (hooks !== undefined) for (const hook of hooks) hook(this.core);
    const wait = this.waits.get(pc);
    return wait === undefined ? 0 : this._skipWait(wait(this.core));
  }

  // Such a loop is skipped up to its end or an alarm; only its last microsecond is executed.
  _skipWait(untilUs) {
    let until = Math.min(untilUs * 1000, this._sliceEnd);
    const next = this.clock.nextAlarm;
    if (next !== null && next.nanos < until) until = next.nanos;
    return Math.max(0, Math.floor((until - this.clock.nanos - 1000) / this.cycleNs));
  }

  /** Runs until the device clock reaches `until` ns, or until a reset. */
  run(until) {
    const { clock, core, fast, cycleNs } = this;
    this._sliceEnd = until;
    while (clock.nanosCounter < until) {
      if (this.mcu.stopped) {
        this._reset();
        return;
      }
      if (this.line.stalledUntil > 0) {
        this._busyUntil = clock.nanos + (this.line.stalledUntil - this.line.now()) * this.rate;
        this.line.stalledUntil = 0;
      }
      const next = clock.nextAlarm;
      if (clock.nanosCounter < this._busyUntil) {
        clock.tick(Math.min(this._busyUntil, until) - clock.nanosCounter);
        continue;
      }
      let spent = 0;
      while (core.interruptsUpdated && core.checkForInterrupts()) {
        core.waiting = false;
        spent += ENTRY_CYCLES;
      }
      if (core.waiting) {
        const end = Math.min(next === null ? clock.nanosCounter + ASLEEP_NS : next.nanos, until);
        const ns = Math.max(end - clock.nanosCounter, cycleNs);
        this.asleep += ns;
        clock.tick(ns);
        continue;
      }
      const end = next === null ? until : Math.min(next.nanos, until);
      spent += fast.run(Math.max(1, Math.ceil((end - clock.nanosCounter) / cycleNs)));
      clock.tick(spent * cycleNs);
    }
  }
}
