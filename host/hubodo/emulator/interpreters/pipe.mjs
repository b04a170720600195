// The two pipes between an interpreter in node and its board; hypercall.py defines the protocol.
import fs from "node:fs";

const ANSWER = 24;
const FLAG_BOARD_OFF = 32;
export const HEADER = 16, FLAG_INPUT = 1, FLAG_ROOM = 2, FLAG_INTERRUPT = 4, FLAG_OPEN = 8, FLAG_PLUGGED = 16;

/** Thrown when the board is switched off instead of replying. */
export class Over extends Error {}

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
    this.length = 0; // length of the reply payload, at response[ANSWER..]
    this.time = 0; // ns, end of the call
    this.quiet = 0; // ns up to which the flags of the board do not change, as far as known
    this._then = null;
    this._ahead = 0; // bytes of the settings of the next board that were received already
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

  /** Waits for a pending reply, if any. */
  settle() {
    const then = this._then;
    if (then === null) return;
    this._then = null;
    const have = this._readAll(ANSWER, 0);
    this.length = this.answer.getUint32(4, true);
    this._readAll(ANSWER + this.length, have);
    this.flags = this.response[2];
    if (this.flags & FLAG_BOARD_OFF) {
      this._ahead = have - ANSWER;
      this.response.copyWithin(0, ANSWER, have);
      throw new Over();
    }
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

  /** Waits for the settings of the next board. */
  start() {
    const have = this._readAll(4, this._ahead), end = 4 + this.response.readUInt32LE(0);
    this._readAll(end, have);
    this._ahead = 0;
    return JSON.parse(this.response.toString("utf8", 4, end));
  }

  /** Payload of the last reply, valid until the next one. */
  get payload() {
    return this.response.subarray(ANSWER, ANSWER + this.length);
  }
}
