// Addresses in an image of MicroPython, by its symbols (`nm`) or by code patterns.
import fs from "node:fs";

const FLASH = 0x10000000;
// The end of mp_hal_delay_us: bl time_us_64; cmp r5, r1; bhi; bne; cmp r4, r0; bhi; pop {r4, r5, r6, pc}.
const DELAY_LOOP = Buffer.from("8d42fbd801d18442f8d870bd", "hex"), CALL = 4;

/** Address by name from lines of `nm`; suffixes of the compiler are removed. */
export function readSymbols(path) {
  const found = new Map();
  for (const row of fs.readFileSync(path, "utf8").split("\n")) {
    const words = row.trim().split(/\s+/);
    if (words.length >= 3) found.set(words.at(-1).split(".")[0], parseInt(words[0], 16));
  }
  return found;
}

/** Map from the pc of each busy-wait loop to a function (core) => device µs at which it ends. */
export function waitLoops(image, symbols) {
  const begin = symbols?.has("mp_hal_delay_us") ? symbols.get("mp_hal_delay_us") - FLASH : 0;
  const at = image.indexOf(DELAY_LOOP, begin);
  if (at < 0 || (begin && at > begin + 64) || (!begin && image.indexOf(DELAY_LOOP, at + 1) >= 0)) return [];
  return [[FLASH + at - CALL, ({ registers: r }) => r[5] * 2 ** 32 + r[4]]];
}
