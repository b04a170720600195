// Time: ns since power-on, from CLOCK_MONOTONIC or stepped here; and the device clock.
const LEAST_NAP_NS = 150e3, LEAD_NS = 2e6, SPIN_NS = 70e3;
const nap = new Int32Array(new SharedArrayBuffer(4));

export class Clock {
  /** config: see runner.mjs. */
  constructor({ t0_ns, t_ns, stepped, paced, pace, clock_ppm, ticks_start_us, t_boot_ns }) {
    this._performanceZero = Number(process.hrtime.bigint() - BigInt(t0_ns)) - performance.now() * 1e6;
    this._stepped = stepped;
    this._paced = paced;
    this._pace = pace;
    this._now = t_ns;
    this._ticksStart = ticks_start_us;
    this._booted = t_boot_ns;
    this.rate = 1 + clock_ppm * 1e-6;
  }

  _real() {
    return (this._performanceZero + performance.now() * 1e6) / this._pace;
  }

  now() {
    return this._stepped ? this._now : this._real();
  }

  // A paced clock is stepped, but waits for wall time when it is `lead` ns ahead.
  _keepPace(lead) {
    if (!this._paced) return;
    const ahead = this._now - this._real();
    if (ahead > lead) Atomics.wait(nap, 0, 0, (ahead * this._pace) / 1e6);
  }

  /** Advances a stepped clock by the duration of an action, ns. */
  spend(ns) {
    if (!this._stepped) return;
    this._now += ns;
    this._keepPace(LEAD_NS);
  }

  waitUntil(t) {
    if (this._stepped) {
      if (t > this._now) this._now = t;
      this._keepPace(LEAST_NAP_NS);
      return;
    }
    for (let left = t - this.now(); left > 0; left = t - this.now()) {
      if (left > SPIN_NS) Atomics.wait(nap, 0, 0, (left - SPIN_NS / 2) / 1e6);
    }
  }

  /** Sets the device clock ahead by `us`. */
  shift(us) {
    this._ticksStart += us;
  }

  /** Time of the device clock, µs. */
  deviceUs() {
    return this._ticksStart + ((this.now() - this._booted) * this.rate) / 1000;
  }
}
