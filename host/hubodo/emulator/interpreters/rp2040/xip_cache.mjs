// The XIP cache between processor and flash chip: 16 KiB, two ways, lines of 8 bytes, least recently used is evicted.
// The cost of a miss is an estimate of the caller: the data sheet of the chip does not specify it.

const SETS = 1024;

export class XipCache {
  /** missCycles: cycles of a miss. */
  constructor(missCycles) {
    this.missCycles = missCycles;
    this.stall = 0; // cycles of the misses since the last count, which resets it to 0
    this.misses = 0;
    this._tags = new Int32Array(2 * SETS).fill(-1);
    this._last = new Uint8Array(SETS); // the way used last
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

  /** Invalidates all lines, as after a write to flash. */
  flush() {
    this._tags.fill(-1);
  }
}
