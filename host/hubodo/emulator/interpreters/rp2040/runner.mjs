// Interpreter of a virtual node: an emulated RP2040 with the MicroPython of the Pico, connected to its board by two pipes.
import fs from "node:fs";
import { Flash } from "./flash.mjs";
import { Line } from "./line.mjs";
import { Meter } from "./meter.mjs";
import { Pico } from "./pico.mjs";
import { rehearse } from "./rehearsal.mjs";
import { readSymbols, waitLoops } from "./symbols.mjs";

rehearse();
const config = JSON.parse(process.argv[2]);
const bootrom = fs.readFileSync(config.bootrom);
const flash = new Flash(config.flash_image, config.unique_id, bootrom);
const rate = 1 + config.clock_ppm * 1e-6;
const pico = new Pico({ flash, bootrom, missCycles: config.miss_cycles, rate, ticksStartUs: config.ticks_start_us });
const booted = config.t_ns; // time of an earlier processor of the same board
const line = new Line(config, () => booted + pico.now);
const symbols = config.symbols === null ? null : readSymbols(config.symbols);
for (const [pc, until] of waitLoops(flash.contents, symbols)) pico.waits.set(pc, until);

pico.onReset = (reason) => line.ask(line.op.RESTARTED, reason);
pico.connect(line);

// ---- time: a paced clock waits for wall time; an emulated second may take several seconds of it ----

const nap = new Int32Array(new SharedArrayBuffer(4));
const zero = BigInt(config.t0_ns);
const LEAST_NAP_NS = 200e3;

function pace() {
  const wall = Number(process.hrtime.bigint() - zero);
  const ahead = (booted + pico.now) * config.pace - wall;
  if (ahead > LEAST_NAP_NS) Atomics.wait(nap, 0, 0, ahead / 1e6);
}

// ---- profiling: counted here, stored by the board ----

const METER_NS = 100e6;
let meter = null, told = 0;

function count() {
  const now = booted + pico.now;
  if (config.meter_from === null || now < config.meter_from * 1e9) return;
  if (meter === null) {
    if (symbols === null) throw new Error("there are no symbols beside this image: nothing can be metered");
    meter = new Meter(pico, symbols, config.profile);
  }
  if (now - told < METER_NS) return;
  told = now;
  line.ask(line.op.METER, 0, Buffer.from(JSON.stringify(meter.report())));
}

for (;;) {
  count();
  if (config.paced) pace();
  if (line.stale(config.refresh_ns)) line.ask(line.op.PING);
  pico.usb.refresh();
  pico.run(pico.clock.nanos + config.refresh_ns);
}
