// The board as the interpreter asks it: one call at a time, at the clock's time; ctrl-C comes with the answers.
import { FLAG_INPUT, FLAG_INTERRUPT, HEADER, Pipe } from "../pipe.mjs";

const CTRL_C = 3, NAP_NS = 10e6, MOST_BYTES = 32768;

export class Board {
  /** config: see runner.mjs; `interpreter`, MicroPython, is given once it is loaded. */
  constructor(config, clock) {
    this.op = config.ops;
    this.clock = clock;
    this.interpreter = null;
    this._config = config;
    this.booting = true;
    this._interrupted = false;
    this._contact = -1e18;
    this._pipe = new Pipe(config.pipes);
    // Payload of the next call, from HEADER on.
    this.request = this._pipe.request;
    this.view = this._pipe.view;
  }

  /** What the last answer said. */
  get flags() {
    return this._pipe.flags;
  }

  /** Payload of the last answer, valid until the next call. */
  get payload() {
    return this._pipe.payload;
  }

  /** Asks with `n` payload bytes already in the request. Ctrl-C that comes before the user's code is kept for it. */
  ask(op, a = 0, n = 0) {
    let result = 0;
    const interruptChar = this.booting ? CTRL_C : this.interpreter._module._mp_hal_get_interrupt_char();
    this._pipe.begin(op, a, n, this.clock.now(), interruptChar, (status) => (result = status));
    this._pipe.settle();
    if (this.flags & FLAG_INTERRUPT) {
      if (this.booting) this._interrupted = true;
      else this.interpreter._module._mp_sched_keyboard_interrupt();
    }
    this.clock.waitUntil(this._pipe.time);
    this.clock.spend(this._config.call_cost_ns);
    this._contact = this.clock.now();
    return result;
  }

  /** The user's code begins: ctrl-C that came before is for it. */
  beginUser() {
    this.booting = false;
    if (this._interrupted) this.interpreter._module._mp_sched_keyboard_interrupt();
  }

  /** Flags no older than one USB frame. */
  freshFlags() {
    if (this.clock.now() - this._contact > this._config.refresh_ns) this.ask(this.op.PING);
    else this.clock.spend(this._config.tick_cost_ns);
    return this.flags;
  }

  /** Asleep, the board is asked now and then whether ctrl-C, the watchdog or a scripted reset came. */
  sleep(ns) {
    const { clock } = this;
    for (const end = clock.now() + ns; ; ) {
      clock.waitUntil(Math.min(end, clock.now() + NAP_NS));
      if (clock.now() - this._contact >= NAP_NS) this.ask(this.op.PING);
      if (clock.now() >= end || this.flags & FLAG_INTERRUPT) return;
    }
  }

  /** Until a byte waits on standard input, at most `ms`, or for ever when it is negative. */
  waitInput(ms) {
    const { clock } = this, { refresh_ns: refresh } = this._config;
    for (const end = ms < 0 ? Infinity : clock.now() + (ms * 1e6) / clock.rate; ; ) {
      if (clock.now() - this._contact > refresh) this.ask(this.op.PING);
      if (this.flags & (FLAG_INPUT | FLAG_INTERRUPT) || clock.now() >= end) return;
      clock.waitUntil(Math.min(end, clock.now() + refresh));
    }
  }

  put(port, bytes, from, length) {
    for (let at = 0; at < length; ) {
      const n = Math.min(length - at, MOST_BYTES);
      this.request.set(bytes.subarray(from + at, from + at + n), HEADER);
      this.ask(this.op.WRITE, port, n);
      at += n;
    }
    return length;
  }

  putText(text) {
    const bytes = Buffer.from(text, "utf8");
    this.put(0, bytes, 0, bytes.length);
  }

  /** Bytes that came on a port within `timeoutMs`: they are the payload. */
  get(port, most, timeoutMs) {
    this.view.setUint32(HEADER, most, true);
    this.view.setInt32(HEADER + 4, timeoutMs, true);
    this.ask(this.op.READ, port, 8);
    return this.payload;
  }
}
