// One session of a processor: from power-on or reset through boot.py, main.py and the prompt, until it is switched off.
import { FLAG_INPUT, FLAG_ROOM } from "../pipe.mjs";
import { Board } from "./board.mjs";
import { Clock } from "./clock.mjs";
import { Devices } from "./devices.mjs";
import { EINTR, withLinuxErrno } from "./errno.mjs";
import { FLASH, layRom, mirrorFlash } from "./flash.mjs";
import { boardModule, TICKS_MASK } from "./module.mjs";

const RAW_BANNER = "raw REPL; CTRL-B to exit\r\n";
// Raw paste needs a blocking read inside the interpreter, which this build lacks: "R", 0 declines it.
const RAW_PASTE = [5, 0x41, 1];
// Raises a pending ctrl-C, as a port does at the end of a file.
const A_JUMP = "[0 for _ in (0, 0)]";

/** load: loads MicroPython with changed imports and options. Ends only by `Over`. */
export async function live(config, pipe, load) {
  const clock = new Clock(config);
  const board = new Board(config, clock, pipe);
  const adapt = (imports) => ownTimeAndMemory(imports, config, clock);
  const mp = await load(adapt, { heapsize: config.heap_bytes, pystack: 8192 });
  board.interpreter = mp;
  const link = new Link(board, mp.FS);
  furnish(mp, board, clock, config);
  link.runFiles(mp, config);
  link.prompt(mp, config.raw);
}

// The clocks of the interpreter are those of the device, and its memory cannot grow, as on a board.
function ownTimeAndMemory(imports, config, clock) {
  imports.env.mp_js_ticks_ms = () => {
    clock.spend(config.tick_cost_ns);
    return Math.floor(clock.deviceUs() / 1000) & TICKS_MASK;
  };
  imports.env.mp_js_time_ms = () => config.epoch_ms + clock.deviceUs() / 1000;
  if (config.random_seed !== null) imports.env.mp_js_random_u32 = repeatable(config.random_seed);
  imports.env.emscripten_resize_heap = () => 0;
  withLinuxErrno(imports);
}

function repeatable(seed) { // Mulberry32 generator with a fixed seed
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6D2B79F5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return (mixed ^ (mixed >>> 14)) >>> 0;
  };
}

/** The board's devices, modules and flash. */
function furnish(mp, board, clock, config) {
  const { FS } = mp, devices = new Devices(board);
  devices.register(FS);
  mp.registerJsModule("_board", { ...boardModule(board, clock, config, FS), ...devices.forModule() });
  layRom(FS, config.rom);
  mirrorFlash(FS, config);

  // Memory beyond the heap is reserved, except for the needs of system calls.
  const spare = mp._module._malloc(config.slack_bytes);
  for (let size = 1 << 22; size >= 1024; size >>= 1) while (mp._module._malloc(size));
  mp._module._free(spare);
}

/** Standard streams: the link of the board. */
class Link {
  constructor(board, FS) {
    this.board = board;
    this._raw = this._muted = false;
    this._tail = "";
    for (const fd of [0, 1, 2]) {
      const stream = FS.getStream(fd);
      stream.stream_ops = { ...stream.stream_ops, ...this._standard(FS) };
    }
  }

  _standard(FS) {
    const { board } = this;
    return {
      write: (_stream, buffer, offset, length) => {
        if (this._muted) return length;
        if (length < 64) {
          const more = Buffer.from(buffer.subarray(offset, offset + length)).toString("latin1");
          this._tail = (this._tail + more).slice(-RAW_BANNER.length);
          if (this._tail === RAW_BANNER) this._raw = true;
        }
        return board.put(0, buffer, offset, length);
      },
      read: (_stream, buffer, offset, length) => {
        for (;;) {
          if (board.takeInterrupt()) throw new FS.ErrnoError(EINTR);
          const got = board.input(length, 100);
          if (got.length) {
            buffer.set(got, offset);
            return got.length;
          }
        }
      },
      poll: () => {
        const f = board.freshFlags();
        return (f & FLAG_INPUT ? 1 : 0) | (f & FLAG_ROOM ? 4 : 0);
      },
    };
  }

  _softReset() {
    this.board.putText("MPY: soft reboot\r\n");
    this.board.ask(this.board.op.SOFT_RESET, this._raw ? 1 : 0);
  }

  _python(mp, source) {
    try {
      mp.runPython(source);
      return true;
    } catch (error) {
      if (error.name !== "PythonError") throw error;
      if (error.type === "SystemExit") this._softReset();
      this.board.putText(error.message.replace(/\r?\n/g, "\r\n"));
      return false;
    }
  }

  /** Runs boot.py and main.py, as a port does. */
  runFiles(mp, config) {
    const { board } = this;
    const exists = (name) => mp.FS.analyzePath(`${FLASH}/${name}`).exists;
    mp.runPython("import sys\nsys.path.insert(0, '/rom')\nimport _boot\n_boot.start()\ndel sys.modules['_boot'], _boot, sys");
    board.ask(board.op.PING);
    for (const name of config.run) {
      if (exists(name)) {
        mp.runPython("import micropython\nmicropython.kbd_intr(3)\ndel micropython");
        board.beginUser();
        const went = this._python(mp, `execfile('/${name}')`) && this._python(mp, A_JUMP);
        mp.runPython("import micropython\nmicropython.kbd_intr(-1)\ndel micropython");
        if (!went) break;
      }
    }
    board.booting = false;
    board.ask(board.op.IDLE);
  }

  /** raw: the raw prompt, for programs. */
  prompt(mp, raw) {
    this._muted = raw;
    mp.replInit();
    this._muted = false;
    if (raw) mp.replProcessChar(1);
    let pasteSeen = 0, lineLength = 0;
    const feed = (byte) => {
      if (this._raw && lineLength === 0 && byte === RAW_PASTE[pasteSeen]) {
        if (++pasteSeen === RAW_PASTE.length) {
          pasteSeen = 0;
          this.board.putText("R\0");
        }
        return;
      }
      const held = RAW_PASTE.slice(0, pasteSeen);
      pasteSeen = 0;
      for (const c of [...held, byte]) {
        if (c === 2) this._raw = false;
        lineLength = c < 5 && c > 0 ? 0 : lineLength + 1;
        if (mp.replProcessChar(c)) this._softReset();
      }
    };
    for (;;) {
      for (const byte of this.board.input(256, 500)) feed(byte);
    }
  }
}
