// The two pipes between an interpreter in node and its board: hypercall.py says what goes through them.
import fs from "node:fs";

const ANSWER = 24;
export const HEADER = 16, FLAG_INPUT = 1, FLAG_ROOM = 2, FLAG_INTERRUPT = 4, FLAG_OPEN = 8, FLAG_PLUGGED = 16;

export function die(error) {
  if (error !== undefined) fs.writeSync(2, `${error?.name === "PythonError" ? error.message : error?.stack ?? error}\n`);
  process.exit(1);
}

export class Pipe {
  /** fds: [requests, responses]. */
  constructor([requests, responses]) {
    this._requests = requests;
    this._responses = responses;
    process.on("uncaughtException", die);
    process.on("unhandledRejection", die);
    this.request = Buffer.alloc(HEADER + 65536);
    this.view = new DataView(this.request.buffer, this.request.byteOffset);
    this.response = Buffer.alloc(ANSWER + 65536);
    this.answer = new DataView(this.response.buffer, this.response.byteOffset);
    this.flags = 0;
    this.length = 0; // of the answer's payload, which is at response[ANSWER..]
    this.time = 0; // ns at which the call was over
    this.quiet = 0; // ns up to which there is nothing to ask for, as far as is known
    this._then = null;
  }

  /** Sends a request at `t` ns with `n` payload bytes already at request[HEADER..]; `then(status)` once it is settled. */
  begin(op, a, n, t, interruptChar, then) {
    this.settle();
    const { request, view } = this;
    request[0] = op;
    view.setInt16(2, interruptChar, true);
    view.setUint16(4, a, true);
    view.setUint16(6, n, true);
    view.setFloat64(8, t, true);
    try {
      for (let sent = 0; sent < HEADER + n; ) sent += fs.writeSync(this._requests, request, sent, HEADER + n - sent);
    } catch {
      die();
    }
    this._then = then;
  }

  /** Waits for the answer that is still out, if there is one. */
  settle() {
    const then = this._then;
    if (then === null) return;
    this._then = null;
    const have = this._readAll(ANSWER, 0);
    this.length = this.answer.getUint32(4, true);
    this._readAll(ANSWER + this.length, have);
    this.flags = this.response[2];
    this.time = this.answer.getFloat64(8, true);
    this.quiet = this.answer.getFloat64(16, true);
    then(this.answer.getInt16(0, true));
  }

  _readAll(n, have) {
    while (have < n) {
      const got = fs.readSync(this._responses, this.response, have, this.response.length - have);
      if (got === 0) die();
      have += got;
    }
    return have;
  }

  /** The payload of the last answer, valid until the next one. */
  get payload() {
    return this.response.subarray(ANSWER, ANSWER + this.length);
  }
}
