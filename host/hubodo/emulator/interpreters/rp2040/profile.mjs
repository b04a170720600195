// Cycles of each Python function, exclusive and inclusive, from entry and exit of MicroPython's bytecode loop.

const LOOP = "mp_execute_bytecode", NAMES = "qstr_find_strn";
// C functions that are listed separately, by purpose.
const OWN = {
  mp_hal_delay_us: "[sleep]",
  machine_i2c_transfer_single: "[I2C transfer]",
  mp_hal_stdout_tx_strn: "[write to USB]",
  gc_alloc: "[gc_alloc]",
  gc_collect: "[gc_collect]",
};
const NATIVE = ["fun_viper_call", "fun_native_call"];
const RETURN = 0xbdf0; // pop {r4-r7, pc}
const QSTRS_IN_POOL = 24, STACK_SLOTS = 11, HANDLER_SLOTS = 3;

export class Profile {
  /** at: address of a function by its name; throws where there is none. */
  constructor(pico, at) {
    this._pico = pico;
    this._functions = new Map();
    this._stack = [];
    this._outside = { name: "(outside)", own: 0, all: 0, calls: 0, slots: 0 };
    this._mark = pico.cycles;
    this._namesAt = this._findNames(at(NAMES));
    const loop = at(LOOP);
    let end = loop;
    while (this._u16(end) !== RETURN) end += 2;
    pico.hook(loop, ({ registers }) => this._enter(this._bytecode(this._u32(registers[0]))));
    pico.hook(end, () => this._leave());
    for (const [symbol, name] of Object.entries(OWN)) {
      this._callable(at(symbol), () => this._function(symbol, name, 0));
    }
    for (const symbol of NATIVE) {
      this._callable(at(symbol), (core) => {
        const object = core.registers[0];
        return this._function(object, `(native code, object at ${object.toString(16)})`, 0);
      });
    }
  }

  // Memory access without effect on the cache.
  _u8(address) {
    return this._pico.mcu.readUint8(address);
  }
  _u16(address) {
    return this._pico.mcu.readUint16(address);
  }
  _u32(address) {
    return this._pico.mcu.readUint32(address);
  }

  // The address of MicroPython's newest pool of names is what its search begins with: ldr rA, [pc, ..]; ldr rB, [rA, ..].
  _findNames(search) {
    for (let pc = search; pc < search + 64; pc += 2) {
      const first = this._u16(pc);
      if (first >> 11 !== 0b01001) continue;
      for (let next = pc + 2; next < pc + 12; next += 2) {
        const second = this._u16(next);
        if (second >> 11 !== 0b01101 || ((second >> 3) & 7) !== ((first >> 8) & 7)) continue;
        return this._u32(((pc + 4) & ~3) + ((first & 0xff) << 2)) + ((second >> 6) & 31) * 4;
      }
    }
    throw new Error(`${NAMES} does not look as expected: this image cannot be profiled`);
  }

  _name(number) {
    let pool = this._u32(this._namesAt);
    const before = () => this._u32(pool + 4) & 0x7fffffff;
    while (number < before()) pool = this._u32(pool);
    let at = this._u32(pool + QSTRS_IN_POOL + 4 * (number - before())), text = "";
    for (let c; (c = this._u8(at++)) !== 0; ) text += String.fromCharCode(c);
    return text;
  }

  // py/bc.h: after the object's code pointer a signature, the size of the prelude, the number of its name.
  _bytecode(object) {
    const known = this._functions.get(object);
    if (known) return known;
    let at = this._u32(object + 12), byte = this._u8(at++);
    let slots = (byte >> 3) & 15, handlers = (byte >> 2) & 1;
    for (let n = 0; byte & 0x80; n++) {
      byte = this._u8(at++);
      slots |= (byte & 0x30) << (2 * n);
      handlers |= (byte & 2) << n;
    }
    while (this._u8(at++) & 0x80);
    let index = 0;
    do {
      byte = this._u8(at++);
      index = (index << 7) | (byte & 0x7f);
    } while (byte & 0x80);
    const names = this._u32(this._u32(object + 4) + 8);
    const name = `${this._name(this._u16(names))}:${this._name(this._u16(names + 2 * index))}`;
    return this._function(object, name, slots + 1 + HANDLER_SLOTS * handlers);
  }

  _function(key, name, slots) {
    let it = this._functions.get(key);
    if (!it) this._functions.set(key, (it = { name, own: 0, all: 0, calls: 0, slots }));
    return it;
  }

  _book() {
    const now = this._pico.cycles;
    (this._stack.at(-1)?.function ?? this._outside).own += now - this._mark;
    this._mark = now;
  }

  _enter(entered) {
    this._book();
    entered.calls++;
    this._stack.push({ function: entered, began: this._mark });
  }

  _leave() {
    this._book();
    const left = this._stack.pop();
    if (left) left.function.all += this._mark - left.began;
  }

  _callable(pc, which) {
    this._pico.hook(pc, (core) => {
      const called = which(core), stack = core.SP;
      if (this._stack.some((it) => it.function === called)) return;
      this._enter(called);
      const depth = this._stack.length;
      const done = this._pico.hook(core.LR & ~1, (there) => {
        if (there.SP !== stack) return;
        done();
        // An exception leaves several functions at once.
        while (this._stack.length >= depth) this._leave();
      });
    });
  }

  /** Returns all functions, the most expensive first; us: converts cycles to µs. heap: their frame exceeds the stack limit. */
  report(us) {
    this._book();
    const rows = [this._outside, ...this._functions.values()].filter((it) => it.own > 0);
    return rows
      .sort((a, b) => b.own - a.own)
      .map(({ name, own, all, calls, slots }) => {
        return { name, own_us: us(own), all_us: us(all), calls, heap: slots > STACK_SLOTS };
      });
  }
}
