// Warm-up of the fast core: every instruction with operands of many kinds, on a processor that is then discarded. V8
// optimises the core for the operands it has seen; a new kind discards the code and costs another half second.
import v8 from "node:v8";
import { RP2040 } from "rp2040js";
import { FORM_OF } from "./decode.mjs";
import { FastCore } from "./thumb.mjs";
import { XipCache } from "./xip_cache.mjs";

const RAM = 0x20000000, FLASH = 0x10000000, ROM = 0, CODE = 0x8000, ROUNDS = 50, END = 16;
// Numbers, and addresses in RAM, flash, SIO and a register behind the APB bridge, which accept any value.
const OPERANDS = [0, 1, -1, 33, 0x7fffffff, RAM + 0x100, RAM + 0x203, FLASH + 0x40, 0xd0000010, 0x4005800c].map((it) => it | 0);
const BARRIER = [0xf3bf, 0x8f4f], SPECIAL = [0xf3ef, 0x8010];

/** Marsaglia's xorshift generator with a fixed seed. */
function drawer(state) {
  return (n) => {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    return (state >>> 0) % n;
  };
}

/** Warms up the fast core before its first use. */
export function rehearse() {
  // Slices are short: on-stack replacement within one is useless, and unoptimised code is slow.
  v8.setFlagsFromString("--no-use-osr");
  v8.setFlagsFromString("--no-concurrent-recompilation");
  const mcu = new RP2040();
  // Random addresses may be invalid: their warnings are suppressed.
  mcu.logger = { debug() {}, info() {}, warn() {}, error() {} };
  mcu.sio = { readUint32: () => 0, writeUint32() {} };
  const fast = new FastCore(mcu, 125e6, new XipCache(50)), draw = drawer(1);
  const alarm = mcu.clock.createAlarm(() => {});
  const marked = [() => draw(2), () => (fast.yield(), 0)];
  const code = { [RAM]: fast.ram16, [FLASH]: fast.flash16, [ROM]: fast.rom16 };
  const one = (base, words, cycles) => {
    const at = base + (base === ROM ? 0x100 : CODE);
    code[base].set(words, (at - base) >> 1);
    for (let r = 0; r < 15; r++) fast.registers[r] = OPERANDS[draw(OPERANDS.length)];
    fast.registers[13] = RAM + 0x1000 - 4 * draw(4);
    fast.registers[15] = at;
    fast.mark(at, draw(8) === 0);
    fast.onMark = marked[draw(2)];
    if (draw(3) === 0) alarm.cancel();
    else alarm.schedule(draw(2) === 0 ? 3.5 : 1e13);
    mcu.core.N = draw(2) === 0;
    mcu.core.Z = draw(2) === 0;
    mcu.core.C = draw(2) === 0;
    mcu.core.V = draw(2) === 0;
    fast.run(cycles);
  };
  const ofForm = [];
  FORM_OF.forEach((form, op) => (ofForm[form] ??= []).push(op));
  for (let round = 0; round < ROUNDS; round++) {
    const base = [RAM, FLASH, ROM][round % 3];
    for (const ops of ofForm.slice(1)) one(base, [ops[draw(ops.length)], BARRIER[1]], 1);
    one(base, SPECIAL, 1);
    one(base, BARRIER, 1);
    // A call, and several consecutive instructions.
    one(base, [0xf000, 0xf800 + draw(4)], 1);
    one(base, [0x0040, 0x1c49, 0x4348, 0xb403, 0xbc03], END);
    // Return from an exception.
    fast.ram32.fill(0xfffffff9, 0x400, 0x500);
    one(base, [0xbd00], 1);
  }
}
