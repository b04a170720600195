// The interpreter of a virtual node: MicroPython for the Pico in an emulated RP2040, whose world is the board behind two pipes.
import fs from "node:fs";
import { Flash } from "./flash.mjs";
import { Line } from "./line.mjs";
import { Pico } from "./pico.mjs";
import { readSymbols, waitLoops } from "./symbols.mjs";

const config = JSON.parse(process.argv[2]);
const bootrom = fs.readFileSync(config.bootrom);
const flash = new Flash(config.flash_image, config.unique_id, bootrom);
const rate = 1 + config.clock_ppm * 1e-6;
const pico = new Pico({ flash, bootrom, missCycles: config.miss_cycles, rate, ticksStartUs: config.ticks_start_us });
const booted = config.t_ns; // of an earlier processor on the same board
const line = new Line(config, () => booted + pico.now);
const symbols = config.symbols === null ? null : readSymbols(config.symbols);
for (const [pc, until] of waitLoops(flash.contents, symbols)) pico.waits.set(pc, until);

pico.onReset = (reason) => line.ask(line.op.RESTARTED, reason);
pico.connect(line);

// ---- time: a paced clock waits for the wall clock, one emulated second of which may take several ----

const nap = new Int32Array(new SharedArrayBuffer(4));
const zero = BigInt(config.t0_ns);
const LEAST_NAP_NS = 200e3;

function pace() {
  const wall = Number(process.hrtime.bigint() - zero);
  const ahead = (booted + pico.now) * config.pace - wall;
  if (ahead > LEAST_NAP_NS) Atomics.wait(nap, 0, 0, ahead / 1e6);
}

for (;;) {
  if (config.paced) pace();
  if (booted + pico.now - line.contact >= config.refresh_ns) line.ask(line.op.PING);
  pico.usb.refresh();
  pico.run(pico.clock.nanos + config.refresh_ns);
}
