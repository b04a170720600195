// Activity profile of the processor from a given time on: cycles asleep, in transfers and busy, allocations, functions.
import { Profile } from "./profile.mjs";

// Functions of MicroPython that wait, transfer bytes over I2C, and allocate memory.
const IDLE = "mp_hal_delay_us", TRANSFER = "machine_i2c_transfer_single", ALLOCATION = "gc_alloc";

/** Calls of one function, with the cycles between its entry and its return. */
class Span {
  constructor(pico, pc, meter) {
    this.calls = this.cycles = this.longest = this.asleep = 0;
    this._pico = pico;
    this._meter = meter;
    this._began = -1;
    pico.hook(pc, (core) => this._enter(core));
  }

  _enter(core) {
    this.calls++;
    if (this._began >= 0) return; // recursive call
    this._began = this._pico.cycles;
    const asleep = this._pico.asleep, stack = core.SP;
    const done = this._pico.hook(core.LR & ~1, (there) => {
      if (there.SP !== stack) return;
      done();
      const cycles = this._pico.cycles - this._began;
      this._began = -1;
      this.cycles += cycles;
      this.asleep += this._pico.asleep - asleep;
      this.longest = Math.max(this.longest, cycles);
    });
  }
}

export class Meter {
  /** symbols: address by name; profile: true to count each function too. Counts from now on. */
  constructor(pico, symbols, profile) {
    const at = (name) => {
      const found = symbols.get(name);
      if (found === undefined) throw new Error(`the symbols of this image have no ${name}: nothing can be metered`);
      return found & ~1;
    };
    this._pico = pico;
    this._from = { now: pico.now, cycles: pico.cycles, asleep: pico.asleep, misses: pico.misses, resets: pico.resets };
    this._idle = new Span(pico, at(IDLE));
    this._transfers = new Span(pico, at(TRANSFER));
    this._allocations = 0;
    pico.hook(at(ALLOCATION), () => this._allocations++);
    this._profile = profile ? new Profile(pico, at) : null;
  }

  /** Returns the profile so far; times in s and µs of the device clock. */
  report() {
    const pico = this._pico, from = this._from;
    const us = (cycles) => (cycles * pico.cycleNs) / 1000;
    // Asleep outside the wait functions: another kind of wait.
    const elsewhere = (pico.asleep - from.asleep - this._idle.asleep - this._transfers.asleep) / 1000;
    return {
      from_s: from.now / 1e9,
      seconds: (pico.now - from.now) / 1e9,
      total_us: us(pico.cycles - from.cycles),
      idle_us: us(this._idle.cycles) + elsewhere,
      transfer_us: us(this._transfers.cycles),
      longest_transfer_us: us(this._transfers.longest),
      transfers: this._transfers.calls,
      allocations: this._allocations,
      cache_misses: pico.misses - from.misses,
      resets: pico.resets - from.resets,
      functions: this._profile?.report(us) ?? [],
    };
  }
}
