// Calls of the interpreter to the board: one at a time, at the time of the clock; replies report ctrl-C.
import { FLAG_INPUT, FLAG_INTERRUPT, HEADER } from "../pipe.mjs";

const CTRL_C = 3, NAP_NS = 10e6, MOST_BYTES = 32768, INPUT_BYTES = 256, NOTHING = Buffer.alloc(0);

export class Board {
  /** config: see runner.mjs; `interpreter`, MicroPython, is set once it is loaded. */
  constructor(config, clock, pipe) {
    this.op = config.ops;
    this.clock = clock;
    this.interpreter = null;
    this._config = config;
    this.booting = true;
    this._interrupted = false;
    this._told = false;
    this._input = NOTHING;
    this._contact = -1e18;
    this._pipe = pipe;
    // Payload of the next call, from HEADER on.
    this.request = this._pipe.request;
    this.view = this._pipe.view;
  }

  /** Flags of the last reply. */
  get flags() {
    return this._pipe.flags;
  }

  /** Payload of the last reply, valid until the next call. */
  get payload() {
    return this._pipe.payload;
  }

  /** Sends a request with `n` payload bytes already in it. Ctrl-C before the user's code is kept for it. */
  ask(op, a = 0, n = 0) {
    let result = 0;
    const interruptChar = this.booting ? CTRL_C : this.interpreter._module._mp_hal_get_interrupt_char();
    this._pipe.begin(op, a, n, this.clock.now(), interruptChar, (status) => (result = status));
    this._pipe.settle();
    if (this.flags & FLAG_INTERRUPT) {
      if (this.booting) this._interrupted = true;
      else this._interrupt();
    }
    this.clock.waitUntil(this._pipe.time);
    this.clock.spend(this._config.call_cost_ns);
    this._contact = this.clock.now();
    return result;
  }

  /** Marks the start of the user's code, which receives an earlier ctrl-C. */
  beginUser() {
    this.booting = false;
    if (this._interrupted) this._interrupt();
  }

  _interrupt() {
    this.interpreter._module._mp_sched_keyboard_interrupt();
    this._told = true;
    this._input = NOTHING;
  }

  /** Returns true if ctrl-C is new: MicroPython raises it at its next jump, so nothing may block before that. */
  takeInterrupt() {
    const told = this._told;
    this._told = false;
    return told;
  }

  /** Returns true if the flags of the board may be older than `ns`. */
  _stale(ns) {
    const now = this.clock.now();
    return now - this._contact >= ns && now >= this._pipe.quiet;
  }

  /** Flags no older than one USB frame. */
  freshFlags() {
    if (this._stale(this._config.refresh_ns)) this.ask(this.op.PING);
    else this.clock.spend(this._config.tick_cost_ns);
    return this._input.length ? this.flags | FLAG_INPUT : this.flags;
  }

  /**
   * Asleep, the board is asked now and then whether ctrl-C, the watchdog or a scripted reset came.
   * True: ctrl-C did, to be asked for again unless MicroPython ends in it; so too `waitInput`.
   */
  sleep(ns) {
    const { clock } = this;
    for (const end = clock.now() + ns; !this._told; ) {
      clock.waitUntil(Math.min(end, clock.now() + NAP_NS));
      if (this._stale(NAP_NS)) this.ask(this.op.PING);
      if (clock.now() >= end) break;
    }
    return this.takeInterrupt();
  }

  /** Waits for a byte on standard input, at most `ms`; forever if negative. */
  waitInput(ms) {
    const { clock } = this, { refresh_ns: refresh } = this._config;
    for (const end = ms < 0 ? Infinity : clock.now() + (ms * 1e6) / clock.rate; !this._told; ) {
      if (this._stale(refresh)) this.ask(this.op.PING);
      if (this._input.length || this.flags & FLAG_INPUT || clock.now() >= end) break;
      clock.waitUntil(Math.min(end, clock.now() + refresh));
    }
    return this.takeInterrupt();
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

  /** Returns at most `most` bytes of standard input received within `timeoutMs`; all available bytes are fetched at once. */
  input(most, timeoutMs) {
    if (this._input.length) this.clock.spend(this._config.tick_cost_ns);
    else this._input = Buffer.from(this.get(0, INPUT_BYTES, timeoutMs));
    const taken = this._input.subarray(0, most);
    this._input = this._input.subarray(taken.length);
    return taken;
  }

  /** Reads the bytes received on a port within `timeoutMs` into the payload. */
  get(port, most, timeoutMs) {
    this.view.setUint32(HEADER, most, true);
    this.view.setInt32(HEADER + 4, timeoutMs, true);
    this.ask(this.op.READ, port, 8);
    return this.payload;
  }
}
