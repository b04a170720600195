// Interface of the emulated machine to the board: requests at the time of the machine, and the effects of replies.
import { HEADER, Pipe } from "../pipe.mjs";

const NO_INTERRUPT_CHAR = -1; // ctrl-C is an ordinary byte: the MicroPython of the chip detects it
const STALLED_NS = 1e6;

export class Line {
  /** config: see interpreter.py; now: true ns since the board was switched on. */
  constructor(config, now) {
    this.op = config.ops;
    this.now = now;
    this.contact = -1e18;
    this.stalledUntil = 0; // ns up to which the processor is stalled
    this._pipe = new Pipe(config.pipes);
  }

  /** Returns true if the flags of the board may be older than `ns`. */
  stale(ns) {
    const now = this.now();
    return now - this.contact >= ns && now >= this._pipe.quiet;
  }

  /** State of the link in the last reply. */
  get flags() {
    return this._pipe.flags;
  }

  /** Sends a request with payload `bytes`; `then(status, payload)` is called once settled, at the latest by the next request. */
  begin(op, a, bytes, then) {
    const pipe = this._pipe;
    // A pending reply may trigger another request; the payload is written after that.
    pipe.settle();
    for (let k = 0; k < bytes.length; k++) pipe.request[HEADER + k] = bytes[k];
    const asked = this.now();
    this.contact = asked;
    pipe.begin(op, a, bytes.length, asked, NO_INTERRUPT_CHAR, (status) => {
      if (pipe.time > asked + STALLED_NS) this.stalledUntil = pipe.time;
      then(status, pipe.payload);
    });
  }

  /** Waits for the pending reply. */
  settle() {
    this._pipe.settle();
  }

  /** Sends a request and waits: returns the status, with a copy of the payload in `payload`. */
  ask(op, a = 0, bytes = []) {
    let result = 0;
    this.begin(op, a, bytes, (status, payload) => {
      result = status;
      this.payload = Buffer.from(payload);
    });
    this.settle();
    return result;
  }
}
