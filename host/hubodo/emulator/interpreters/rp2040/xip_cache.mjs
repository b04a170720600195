// The cache between the processor and its flash chip: 16 KiB, two ways, lines of 8 bytes, least recently used goes out.
// What a miss costs is an estimate of the caller's: the chip's data sheet does not say.

const SETS = 1024;

export class XipCache {
  /** missCycles: how long the processor waits for a line that is not there. */
  constructor(missCycles) {
    this.missCycles = missCycles;
    this.stall = 0; // cycles to be waited for what was touched since; whoever counts them sets it to 0
    this.misses = 0;
    this._tags = new Int32Array(2 * SETS).fill(-1);
    this._last = new Uint8Array(SETS); // the way that was used last
  }

  /** The processor reads at `offset` of the flash. */
  touch(offset) {
    const line = offset >>> 3, set = line & (SETS - 1), way = set << 1;
    if (this._tags[way] === line) this._last[set] = 0;
    else if (this._tags[way + 1] === line) this._last[set] = 1;
    else {
      const out = this._last[set] ^ 1;
      this._tags[way + out] = line;
      this._last[set] = out;
      this.misses++;
      this.stall += this.missCycles;
    }
  }

  /** Forgets all, as after the flash was written. */
  flush() {
    this._tags.fill(-1);
  }
}
