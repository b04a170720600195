// Where in an image of MicroPython things are: by its symbols (`nm`), or by what they look like.
import fs from "node:fs";

const FLASH = 0x10000000;
// The end of mp_hal_delay_us: bl time_us_64; cmp r5, r1; bhi; bne; cmp r4, r0; bhi; pop {r4, r5, r6, pc}.
const DELAY_LOOP = Buffer.from("8d42fbd801d18442f8d870bd", "hex"), CALL = 4;

/** Address by name from lines of `nm`; what the compiler put behind a name is left out. */
export function readSymbols(path) {
  const found = new Map();
  for (const row of fs.readFileSync(path, "utf8").split("\n")) {
    const words = row.trim().split(/\s+/);
    if (words.length >= 3) found.set(words.at(-1).split(".")[0], parseInt(words[0], 16));
  }
  return found;
}

/** pc of each loop that only waits for the clock → (core) => device µs until which it waits. */
export function waitLoops(image, symbols) {
  const begin = symbols?.has("mp_hal_delay_us") ? symbols.get("mp_hal_delay_us") - FLASH : 0;
  const at = image.indexOf(DELAY_LOOP, begin);
  if (at < 0 || (begin && at > begin + 64) || (!begin && image.indexOf(DELAY_LOOP, at + 1) >= 0)) return [];
  return [[FLASH + at - CALL, ({ registers: r }) => r[5] * 2 ** 32 + r[4]]];
}
