// lockstep.mjs RUNNERS CHIP BOOTROM N: N instructions by the fast core and by the core of rp2040js, side by side.
import fs from "node:fs";
import { pathToFileURL } from "node:url";
import path from "node:path";

const [runners, chip, rom, n] = process.argv.slice(2);
const from = (name) => import(pathToFileURL(path.join(runners, name)));
const { Flash } = await from("flash.mjs");
const { Pico } = await from("pico.mjs");
const bootrom = fs.readFileSync(rom);

function machine() {
  const nothing = () => 0;
  const line = { op: {}, flags: 0, stalledUntil: 0, ask: nothing, begin: nothing, settle: nothing };
  const pico = new Pico({ flash: new Flash(chip, "00", bootrom), bootrom, missCycles: 0, rate: 1, ticksStartUs: 0 });
  pico.connect(line);
  return pico;
}

const SHIFTS = [0x102, 0x103, 0x104, 0x107];
const [ours, theirs] = [machine(), machine()];
const alike = (a, b) =>
  a.N === b.N && a.Z === b.Z && a.C === b.C && a.V === b.V && a.registers.every((value, k) => value === b.registers[k]);
const state = ({ registers: r, N, Z, C, V }) => `${[...r].map((x) => x.toString(16))} ${[N, Z, C, V].map(Number)}`;
for (let k = 0; k < Number(n); k++) {
  const pc = ours.core.PC;
  for (const { core } of [ours, theirs]) while (core.interruptsUpdated && core.checkForInterrupts()) core.waiting = false;
  const spent = ours.fast.run(1) * ours.cycleNs;
  // Both look at the clock at the same time; the timer is read within an instruction.
  theirs.clock.nanosCounter += spent;
  theirs.core.executeInstruction();
  theirs.clock.nanosCounter -= spent;
  // A shift by a register that holds 0 leaves the carry alone; rp2040js changes it.
  const op = ours.mcu.readUint16(pc);
  if (SHIFTS.includes(op >> 6)) theirs.core.C = ours.core.C;
  ours.clock.tick(spent);
  theirs.clock.tick(spent);
  for (const { core, clock } of [ours, theirs]) {
    while (core.waiting) clock.tick(Math.max(clock.nextAlarm.nanos - clock.nanosCounter, ours.cycleNs));
  }
  if (!alike(ours.core, theirs.core)) {
    console.log(`after ${k}: ${pc.toString(16)} ${op.toString(16)}\n${state(ours.core)}\n${state(theirs.core)}`);
    process.exit(1);
  }
}
console.log(`${n} instructions alike`);
process.exit(0);
