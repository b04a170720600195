// The interpreter of a virtual node: MicroPython (WebAssembly) whose world is the board behind two pipes.
import fs from "node:fs";
import path from "node:path";
import { FLAG_INPUT, FLAG_INTERRUPT, FLAG_ROOM, HEADER, Pipe } from "../pipe.mjs";

const config = JSON.parse(process.argv[2]);
const { ops: OP, stepped, paced } = config;
const TICKS_MASK = 0x3fffffff;
const pipe = new Pipe(config.pipes);
const { request, view, response, answer } = pipe;

// ---- time: ns since the board was switched on, on the board's CLOCK_MONOTONIC or stepped here ----

const performanceZero = Number(process.hrtime.bigint() - BigInt(config.t0_ns)) - performance.now() * 1e6;
let steppedNow = config.t_ns;
const realNow = () => (performanceZero + performance.now() * 1e6) / config.pace;
const now = stepped ? () => steppedNow : realNow;
const nap = new Int32Array(new SharedArrayBuffer(4));
const LEAST_NAP_NS = 150e3, LEAD_NS = 2e6, SPIN_NS = 70e3, REFRESH_NS = config.refresh_ns, NAP_NS = 10e6;

// A paced clock is stepped, but waits for the wall clock once it is `lead` ns ahead of it.
function pace(lead) {
  if (!paced) return;
  const ahead = steppedNow - realNow();
  if (ahead > lead) Atomics.wait(nap, 0, 0, (ahead * config.pace) / 1e6);
}

function spend(ns) {
  if (!stepped) return;
  steppedNow += ns;
  pace(LEAD_NS);
}

function waitUntil(t) {
  if (stepped) {
    if (t > steppedNow) steppedNow = t;
    pace(LEAST_NAP_NS);
    return;
  }
  for (let left = t - now(); left > 0; left = t - now()) {
    if (left > SPIN_NS) Atomics.wait(nap, 0, 0, (left - SPIN_NS / 2) / 1e6);
  }
}

const rate = 1 + config.clock_ppm * 1e-6;
const deviceUs = () => config.ticks_start_us + ((now() - config.t_boot_ns) * rate) / 1000;

// ---- hypercalls ----

const CTRL_C = 3;
let flags = 0, answerLength = 0, lastContact = -1e18, interpreter = null, booting = true, interrupted = false;

// Ctrl-C that comes before the user's code is kept for it.
// Asks with `n` payload bytes already at request[HEADER..]; the payload of the answer is at response[HEADER..].
function ask(op, a = 0, n = 0) {
  let result = 0;
  const interruptChar = booting ? CTRL_C : interpreter._module._mp_hal_get_interrupt_char();
  pipe.begin(op, a, n, now(), interruptChar, (status) => (result = status));
  pipe.settle();
  answerLength = pipe.length;
  flags = pipe.flags;
  if (flags & FLAG_INTERRUPT) {
    if (booting) interrupted = true;
    else interpreter._module._mp_sched_keyboard_interrupt();
  }
  waitUntil(pipe.time);
  spend(config.call_cost_ns);
  lastContact = now();
  return result;
}

// Flags no older than one USB frame.
function freshFlags() {
  if (now() - lastContact > REFRESH_NS) ask(OP.PING);
  else spend(config.tick_cost_ns);
  return flags;
}

// Asleep, the board is asked now and then whether ctrl-C, the watchdog or a scripted reset came.
function sleepNs(ns) {
  for (const end = now() + ns; ; ) {
    waitUntil(Math.min(end, now() + NAP_NS));
    if (now() - lastContact >= NAP_NS) ask(OP.PING);
    if (now() >= end || flags & FLAG_INTERRUPT) return;
  }
}

// Until a byte waits on standard input, at most `ms`, or for ever when it is negative.
function waitInput(ms) {
  for (const end = ms < 0 ? Infinity : now() + (ms * 1e6) / rate; ; ) {
    if (now() - lastContact > REFRESH_NS) ask(OP.PING);
    if (flags & (FLAG_INPUT | FLAG_INTERRUPT) || now() >= end) return;
    waitUntil(Math.min(end, now() + REFRESH_NS));
  }
}

// ---- errno: this build reports Emscripten's numbers where boards, and mpremote, know Linux's ----

const ERRNO = { 2: 13, 6: 11, 8: 9, 10: 16, 20: 17, 28: 22, 29: 5, 31: 21, 37: 36, 44: 2, 48: 12, 51: 28, 54: 20, 55: 39, 63: 1, 69: 30, 75: 18 };
const EINTR = 27;

function withLinuxErrno(imports) {
  for (const [name, f] of Object.entries(imports.env)) {
    if (name.startsWith("__syscall_")) {
      imports.env[name] = (...args) => {
        const r = f(...args);
        return r < 0 ? -(ERRNO[-r] ?? -r) : r;
      };
    }
  }
  const wasi = imports.wasi_snapshot_preview1;
  for (const name of ["fd_close", "fd_sync", "fd_seek", "fd_read", "fd_write"]) {
    const f = wasi[name];
    wasi[name] = (...args) => {
      const r = f(...args);
      return r > 0 ? ERRNO[r] ?? r : r;
    };
  }
}

// The interpreter's own clocks are the device's, and its memory does not grow: a board has what it has.
const instantiate = WebAssembly.instantiate;
WebAssembly.instantiate = async (bytes, imports) => {
  imports.env.mp_js_ticks_ms = () => {
    spend(config.tick_cost_ns);
    return Math.floor(deviceUs() / 1000) & TICKS_MASK;
  };
  imports.env.mp_js_time_ms = () => config.epoch_ms + deviceUs() / 1000;
  imports.env.emscripten_resize_heap = () => 0;
  withLinuxErrno(imports);
  return instantiate(bytes, imports);
};

const { loadMicroPython } = await import(config.micropython);
const mp = await loadMicroPython({ heapsize: config.heap_bytes, pystack: 8192 });
const FS = mp.FS;
interpreter = mp;

// ---- standard streams are the link ----

let raw = false, muted = false, tail = "";
const RAW_BANNER = "raw REPL; CTRL-B to exit\r\n";

function put(port, bytes, from, length) {
  for (let at = 0; at < length; ) {
    const n = Math.min(length - at, 32768);
    request.set(bytes.subarray(from + at, from + at + n), HEADER);
    ask(OP.WRITE, port, n);
    at += n;
  }
  return length;
}

function putText(text) {
  const bytes = Buffer.from(text, "utf8");
  put(0, bytes, 0, bytes.length);
}

function get(port, most, timeoutMs) {
  view.setUint32(HEADER, most, true);
  view.setInt32(HEADER + 4, timeoutMs, true);
  ask(OP.READ, port, 8);
  return answerLength;
}

const standard = {
  write(_stream, buffer, offset, length) {
    if (muted) return length;
    if (length < 64) {
      tail = (tail + Buffer.from(buffer.subarray(offset, offset + length)).toString("latin1")).slice(-RAW_BANNER.length);
      if (tail === RAW_BANNER) raw = true;
    }
    return put(0, buffer, offset, length);
  },
  read(_stream, buffer, offset, length) {
    for (;;) {
      const n = get(0, length, 100);
      if (flags & FLAG_INTERRUPT) throw new FS.ErrnoError(EINTR);
      if (n) {
        buffer.set(response.subarray(HEADER, HEADER + n), offset);
        return n;
      }
    }
  },
  poll() {
    const f = freshFlags();
    return (f & FLAG_INPUT ? 1 : 0) | (f & FLAG_ROOM ? 4 : 0);
  },
};
for (const fd of [0, 1, 2]) {
  const stream = FS.getStream(fd);
  stream.stream_ops = { ...stream.stream_ops, ...standard };
}

// ---- devices: what machine.py opens as files, so that a buffer passes without allocation ----

let target = 0, address = 0, register = 0, addressBytes = 1, mode = 0, result = 0;
const MEM = 0, FLASH = "/flash";

const i2c = {
  open() {},
  close() {},
  llseek: () => 0,
  read(_stream, buffer, offset, length) {
    if (result < 0) return 0;
    request[HEADER] = address;
    request[HEADER + 1] = addressBytes;
    view.setUint16(HEADER + 2, register, true);
    view.setUint16(HEADER + 4, length, true);
    result = ask(mode === MEM ? OP.I2C_READ_MEM : OP.I2C_READ, target, 6);
    if (result < 0) return 0;
    buffer.set(response.subarray(HEADER, HEADER + answerLength), offset);
    return answerLength;
  },
  write(_stream, buffer, offset, length) {
    request[HEADER] = address;
    request[HEADER + 1] = addressBytes;
    view.setUint16(HEADER + 2, register, true);
    request.set(buffer.subarray(offset, offset + length), HEADER + 4);
    result = ask(mode === MEM ? OP.I2C_WRITE_MEM : OP.I2C_WRITE, target, 4 + length);
    return length;
  },
};

const FEED_NS = 4e6;
let lastFed = -1e18;
let port = 0, readTimeout = 0;
const serial = {
  open() {},
  close() {},
  llseek: () => 0,
  read(_stream, buffer, offset, length) {
    const n = get(port, length, readTimeout);
    buffer.set(response.subarray(HEADER, HEADER + n), offset);
    return n;
  },
  write(_stream, buffer, offset, length) {
    request.set(buffer.subarray(offset, offset + length), HEADER);
    return ask(OP.WRITE, port, length);
  },
};

let socket = 0, armed = false;
const peer = Buffer.alloc(6);
const udp = {
  open() {},
  close() {},
  llseek: () => 0,
  // readinto goes on until its buffer is full: one datagram, then end of file.
  read(_stream, buffer, offset, length) {
    if (!armed) return 0;
    armed = false;
    view.setUint32(HEADER, length, true);
    view.setInt32(HEADER + 4, readTimeout, true);
    result = ask(OP.UDP_RECV, socket, 8);
    if (result < 0) return 0;
    response.copy(peer, 0, HEADER, HEADER + 6);
    buffer.set(response.subarray(HEADER + 6, HEADER + answerLength), offset);
    return answerLength - 6;
  },
  write(_stream, buffer, offset, length) {
    peer.copy(request, HEADER);
    request.set(buffer.subarray(offset, offset + length), HEADER + 6);
    result = ask(OP.UDP_SEND, socket, 6 + length);
    return length;
  },
};

[["i2c", i2c], ["serial", serial], ["udp", udp]].forEach(([name, device], k) => {
  FS.registerDevice(FS.makedev(64, k), device);
  FS.mkdev(`/dev/${name}`, FS.makedev(64, k));
});

mp.registerJsModule("_board", {
  ticks_us() {
    spend(config.tick_cost_ns);
    return deviceUs() % (TICKS_MASK + 1) | 0;
  },
  ticks_ms() {
    spend(config.tick_cost_ns);
    return (deviceUs() / 1000) % (TICKS_MASK + 1) | 0;
  },
  sleep_us: (us) => sleepNs((us * 1000) / rate),
  sleep_ms: (ms) => sleepNs((ms * 1e6) / rate),
  wait_input: waitInput,
  i2c_to(bus_mode, to, memory, bytes) {
    target = bus_mode >> 1;
    mode = bus_mode & 1;
    address = to;
    register = memory;
    addressBytes = bytes;
    result = 0;
  },
  result: () => result,
  i2c_init(bus, frequency, scl, sda) {
    view.setUint32(HEADER, frequency, true);
    view.setInt8(HEADER + 4, scl);
    view.setInt8(HEADER + 5, sda);
    return ask(OP.I2C_INIT, bus, 6);
  },
  i2c_scan(bus) {
    const status = ask(OP.I2C_SCAN, bus);
    return status < 0 ? "" : Buffer.from(response.subarray(HEADER, HEADER + answerLength)).toString("latin1");
  },
  pin_init(pin, pinMode, pull) {
    request[HEADER] = pinMode;
    view.setInt8(HEADER + 1, pull);
    return ask(OP.PIN_INIT, pin, 2);
  },
  pin_set(pin, level) {
    request[HEADER] = level;
    return ask(OP.PIN_SET, pin, 1);
  },
  pin_get: (pin) => ask(OP.PIN_GET, pin),
  adc(channel) {
    ask(OP.ADC_READ, channel);
    return answer.getUint16(HEADER, true);
  },
  // A watchdog is timed in ms: feeding it more often than that is not told to the board.
  wdt(start, ms) {
    if (start === 0 && now() - lastFed < FEED_NS) {
      spend(config.tick_cost_ns);
      return 0;
    }
    lastFed = now();
    view.setUint32(HEADER, ms, true);
    return ask(OP.WDT, start, 4);
  },
  reset: () => ask(OP.RESET),
  serial_to(to, timeoutMs) {
    port = to;
    readTimeout = timeoutMs;
  },
  count: (from) => ask(OP.COUNT, from),
  uart_init(to, baud, toSend, toRead) {
    view.setUint32(HEADER, baud, true);
    view.setUint16(HEADER + 4, toSend, true);
    view.setUint16(HEADER + 6, toRead, true);
    return ask(OP.UART_INIT, to, 8);
  },
  wlan: (what) => ask(OP.WLAN, what),
  udp_open: () => ask(OP.UDP_OPEN),
  udp_bind(handle, local) {
    view.setUint16(HEADER, local, true);
    return ask(OP.UDP_BIND, handle, 2);
  },
  udp_close: (handle) => ask(OP.UDP_CLOSE, handle),
  udp_to(handle, high, low, remote) {
    socket = handle;
    result = 0;
    peer.writeUInt16BE(high, 0);
    peer.writeUInt16BE(low, 2);
    peer.writeUInt16LE(remote, 4);
  },
  udp_from(handle, timeoutMs) {
    socket = handle;
    readTimeout = timeoutMs;
    armed = true;
    result = 0;
  },
  udp_peer: (k) => (k < 4 ? peer[k] : peer.readUInt16LE(4)),
  rename(from, to) {
    try {
      FS.rename(FLASH + from, FLASH + to);
      return 0;
    } catch (error) {
      return ERRNO[error.errno] ?? error.errno ?? 5;
    }
  },
  unique_id: () => config.unique_id,
  reset_cause: () => config.reset_cause,
  register: (address) => config.registers[address] ?? 0,
  machine_name: () => config.machine,
  platform: () => config.platform,
  radio: () => config.radio,
  pin_exists: (pin) => config.pins.includes(pin),
  pin_measures: (pin) => config.adc_pins.includes(pin),
  i2c_count: () => config.i2c_count,
  uart_count: () => config.uart_count,
  frequency: () => config.frequency_hz,
  heap_bytes: () => config.heap_bytes,
});

// ---- flash: a host directory, mirrored on every close, removal and rename, as a board keeps what was closed ----

function load(from, to) {
  for (const entry of fs.readdirSync(from, { withFileTypes: true })) {
    const host = path.join(from, entry.name), here = `${to}/${entry.name}`;
    if (entry.isDirectory()) {
      FS.mkdir(here);
      load(host, here);
    } else FS.writeFile(here, fs.readFileSync(host));
  }
}

FS.mkdir(FLASH);
load(config.flash, FLASH);
FS.mkdir("/rom");
for (const name of fs.readdirSync(config.rom)) FS.writeFile(`/rom/${name}`, fs.readFileSync(path.join(config.rom, name)));

const onHost = (p) => (p.startsWith(`${FLASH}/`) ? path.join(config.flash, p.slice(FLASH.length)) : null);
const absolute = (p) => (p.startsWith("/") ? p : `${FS.cwd()}/${p}`.replace("//", "/"));
const { close, unlink, mkdir, rmdir, rename } = FS;

// What is on the host is a change that stays, and a line of the journal where one is kept.
function changed(what, p, more) {
  if (config.flash_journal) fs.appendFileSync(config.flash_journal, `${JSON.stringify({ what, path: p, ...more })}\n`);
}

FS.close = (stream) => {
  const host = stream.path && (stream.flags & 3) !== 0 ? onHost(stream.path) : null;
  const node = stream.node;
  close(stream);
  // A file without bytes has no typed array to take them from.
  if (host === null || !FS.isFile(node.mode)) return;
  const bytes = Buffer.from(node.usedBytes ? node.contents.subarray(0, node.usedBytes) : "");
  fs.writeFileSync(host, bytes);
  changed("write", stream.path.slice(FLASH.length), { base64: bytes.toString("base64") });
};
FS.unlink = (p) => {
  unlink(p);
  const host = onHost(absolute(p));
  if (host === null) return;
  fs.unlinkSync(host);
  changed("unlink", absolute(p).slice(FLASH.length));
};
FS.mkdir = (p, m) => {
  const made = mkdir(p, m);
  const host = onHost(absolute(p));
  if (host === null) return made;
  fs.mkdirSync(host);
  changed("mkdir", absolute(p).slice(FLASH.length));
  return made;
};
FS.rmdir = (p) => {
  rmdir(p);
  const host = onHost(absolute(p));
  if (host === null) return;
  fs.rmdirSync(host);
  changed("rmdir", absolute(p).slice(FLASH.length));
};
FS.rename = (a, b) => {
  rename(a, b);
  const [from, to] = [onHost(absolute(a)), onHost(absolute(b))];
  if (from === null || to === null) return;
  fs.renameSync(from, to);
  changed("rename", absolute(a).slice(FLASH.length), { to: absolute(b).slice(FLASH.length) });
};

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
    putText(error.message.replace(/\r?\n/g, "\r\n"));
    return false;
  }
}

function softReset() {
  putText("MPY: soft reboot\r\n");
  ask(OP.SOFT_RESET, raw ? 1 : 0);
}

const exists = (name) => FS.analyzePath(`${FLASH}/${name}`).exists;

mp.runPython("import sys\nsys.path.insert(0, '/rom')\nimport _boot\n_boot.start()\ndel sys.modules['_boot'], _boot, sys");
ask(OP.PING);
for (const name of config.run) {
  if (exists(name)) {
    mp.runPython("import micropython\nmicropython.kbd_intr(3)\ndel micropython");
    booting = false;
    if (interrupted) mp._module._mp_sched_keyboard_interrupt();
    const went = python(`execfile('/${name}')`);
    mp.runPython("import micropython\nmicropython.kbd_intr(-1)\ndel micropython");
    if (!went) break;
  }
}
booting = false;
ask(OP.IDLE);

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
      putText("R\0");
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
  const n = get(0, 256, 500);
  for (const byte of Buffer.from(response.subarray(HEADER, HEADER + n))) feed(byte);
}
