// The board as the emulated machine sees it: requests at the machine's own time, and what their answers bring about.
import { HEADER, Pipe } from "../pipe.mjs";

const NO_INTERRUPT_CHAR = -1; // ctrl-C is a byte like any other: the chip's own MicroPython looks for it
const STALLED_NS = 1e6;

export class Line {
  /** config: see interpreter.py; now: true ns since the board was switched on. */
  constructor(config, now) {
    this.op = config.ops;
    this.now = now;
    this.contact = -1e18;
    this.stalledUntil = 0; // the processor is busy with something else until then, ns
    this._pipe = new Pipe(config.pipes);
  }

  /** Whether the board may have something to tell that is older than `ns`. */
  stale(ns) {
    const now = this.now();
    return now - this.contact >= ns && now >= this._pipe.quiet;
  }

  /** What the board's last answer said of the link. */
  get flags() {
    return this._pipe.flags;
  }

  /** Asks with a payload of `bytes`; `then(status, payload)` once settled, at the latest by the next request. */
  begin(op, a, bytes, then) {
    const pipe = this._pipe;
    // An answer that is still out may ask in its turn; the payload is written after that.
    pipe.settle();
    for (let k = 0; k < bytes.length; k++) pipe.request[HEADER + k] = bytes[k];
    const asked = this.now();
    this.contact = asked;
    pipe.begin(op, a, bytes.length, asked, NO_INTERRUPT_CHAR, (status) => {
      if (pipe.time > asked + STALLED_NS) this.stalledUntil = pipe.time;
      then(status, pipe.payload);
    });
  }

  /** Waits for the answer that is out. */
  settle() {
    this._pipe.settle();
  }

  /** Asks and waits: the status, and the payload as a copy in `payload`. */
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
