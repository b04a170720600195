// The interpreter of a virtual node: MicroPython (WebAssembly) whose world is the board behind two pipes.
import v8 from "node:v8";
import "./table.mjs";
import { FLAG_INPUT, FLAG_ROOM } from "../pipe.mjs";
import { Board } from "./board.mjs";
import { Clock } from "./clock.mjs";
import { Devices } from "./devices.mjs";
import { EINTR, withLinuxErrno } from "./errno.mjs";
import { FLASH, layRom, mirrorFlash } from "./flash.mjs";
import { boardModule, TICKS_MASK } from "./module.mjs";

// What MicroPython's code would gain from the second compiler is less than that takes, but for rides of minutes.
v8.setFlagsFromString("--liftoff-only");

const config = JSON.parse(process.argv[2]); // what the board's processor.py tells
const clock = new Clock(config);
const board = new Board(config, clock);

// The interpreter's own clocks are the device's, and its memory does not grow: a board has what it has.
const instantiate = WebAssembly.instantiate;
WebAssembly.instantiate = async (bytes, imports) => {
  imports.env.mp_js_ticks_ms = () => {
    clock.spend(config.tick_cost_ns);
    return Math.floor(clock.deviceUs() / 1000) & TICKS_MASK;
  };
  imports.env.mp_js_time_ms = () => config.epoch_ms + clock.deviceUs() / 1000;
  if (config.random_seed !== null) imports.env.mp_js_random_u32 = repeatable(config.random_seed);
  imports.env.emscripten_resize_heap = () => 0;
  withLinuxErrno(imports);
  return instantiate(bytes, imports);
};

function repeatable(seed) { // Mulberry32: the same numbers after each start
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6D2B79F5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return (mixed ^ (mixed >>> 14)) >>> 0;
  };
}

const { loadMicroPython } = await import(config.micropython);
const mp = await loadMicroPython({ heapsize: config.heap_bytes, pystack: 8192 });
const FS = mp.FS;
board.interpreter = mp;

// ---- standard streams are the link ----

let raw = false, muted = false, tail = "";
const RAW_BANNER = "raw REPL; CTRL-B to exit\r\n";

const standard = {
  write(_stream, buffer, offset, length) {
    if (muted) return length;
    if (length < 64) {
      tail = (tail + Buffer.from(buffer.subarray(offset, offset + length)).toString("latin1")).slice(-RAW_BANNER.length);
      if (tail === RAW_BANNER) raw = true;
    }
    return board.put(0, buffer, offset, length);
  },
  read(_stream, buffer, offset, length) {
    for (;;) {
      if (board.takeInterrupt()) throw new FS.ErrnoError(EINTR);
      const got = board.input(length, 100);
      if (got.length) {
        buffer.set(got, offset);
        return got.length;
      }
    }
  },
  poll() {
    const f = board.freshFlags();
    return (f & FLAG_INPUT ? 1 : 0) | (f & FLAG_ROOM ? 4 : 0);
  },
};
for (const fd of [0, 1, 2]) {
  const stream = FS.getStream(fd);
  stream.stream_ops = { ...stream.stream_ops, ...standard };
}

// ---- the board's devices, modules and flash ----

const devices = new Devices(board);
devices.register(FS);
mp.registerJsModule("_board", { ...boardModule(board, clock, config, FS), ...devices.forModule() });
layRom(FS, config.rom);
mirrorFlash(FS, config);

// What is left of the memory beyond the heap is taken away, but for what system calls need.
const spare = mp._module._malloc(config.slack_bytes);
for (let size = 1 << 22; size >= 1024; size >>= 1) while (mp._module._malloc(size));
mp._module._free(spare);

// ---- boot as a port does: boot.py, main.py, prompt ----

function python(source) {
  try {
    mp.runPython(source);
    return true;
  } catch (error) {
    if (error.name !== "PythonError") throw error;
    if (error.type === "SystemExit") softReset();
    board.putText(error.message.replace(/\r?\n/g, "\r\n"));
    return false;
  }
}

function softReset() {
  board.putText("MPY: soft reboot\r\n");
  board.ask(board.op.SOFT_RESET, raw ? 1 : 0);
}

// Where a ctrl-C that still waits strikes, as a port raises it when a file is over.
const A_JUMP = "[0 for _ in (0, 0)]";
const exists = (name) => FS.analyzePath(`${FLASH}/${name}`).exists;

mp.runPython("import sys\nsys.path.insert(0, '/rom')\nimport _boot\n_boot.start()\ndel sys.modules['_boot'], _boot, sys");
board.ask(board.op.PING);
for (const name of config.run) {
  if (exists(name)) {
    mp.runPython("import micropython\nmicropython.kbd_intr(3)\ndel micropython");
    board.beginUser();
    const went = python(`execfile('/${name}')`) && python(A_JUMP);
    mp.runPython("import micropython\nmicropython.kbd_intr(-1)\ndel micropython");
    if (!went) break;
  }
}
board.booting = false;
board.ask(board.op.IDLE);

muted = config.raw;
mp.replInit();
muted = false;
if (config.raw) mp.replProcessChar(1);
// Raw paste needs a blocking read inside the interpreter, which this build has not: "R", 0 declines it.
const RAW_PASTE = [5, 0x41, 1];
let pasteSeen = 0, lineLength = 0;

function feed(byte) {
  if (raw && lineLength === 0 && byte === RAW_PASTE[pasteSeen]) {
    if (++pasteSeen === RAW_PASTE.length) {
      pasteSeen = 0;
      board.putText("R\0");
    }
    return;
  }
  const held = RAW_PASTE.slice(0, pasteSeen);
  pasteSeen = 0;
  for (const c of [...held, byte]) {
    if (c === 2) raw = false;
    lineLength = c < 5 && c > 0 ? 0 : lineLength + 1;
    if (mp.replProcessChar(c)) softReset();
  }
}

for (;;) {
  for (const byte of board.input(256, 500)) feed(byte);
}
