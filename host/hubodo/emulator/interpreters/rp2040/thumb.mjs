// The fast core: executes ARMv6-M instructions on the registers and memory of rp2040js for a number of cycles.
// Rare instructions (exceptions, special registers, sleep) are left to rp2040js. Cycles: Cortex-M0+ manual, 3.3.
// One function with one switch, so that the compiler keeps flags, counter and memory in host registers.
import { FORM_OF } from "./decode.mjs";

const RAM = 0x20000000, FLASH = 0x10000000, SIO = 0xd, APB = 0x4;
const SP = 13, LR = 14, PC = 15;
const jump = (op) => (((op << 24) >> 24) << 1) + 2; // of a conditional branch, beyond the next instruction

export class FastCore {
  /**
   * mcu: an RP2040 of rp2040js; hz: of its processor; cache: an XipCache, or null for one that never misses.
   * Where a pc is marked `onMark(pc)` is called first and answers how many cycles pass before the instruction.
   */
  constructor(mcu, hz, cache) {
    this.mcu = mcu;
    this.core = mcu.core;
    this.clock = mcu.clock;
    this.cycleNs = 1e9 / hz;
    this.cache = cache;
    this.registers = new Int32Array(mcu.core.registers.buffer);
    this.ram8 = mcu.sram;
    this.ram16 = new Uint16Array(mcu.sram.buffer);
    this.ram32 = new Int32Array(mcu.sram.buffer);
    this.flash8 = mcu.flash;
    this.flash16 = new Uint16Array(mcu.flash.buffer);
    this.flash32 = new Int32Array(mcu.flash.buffer);
    this.rom16 = new Uint16Array(mcu.bootrom.buffer);
    this.flashMarks = new Uint8Array(1 << 20);
    this.ramMarks = new Uint8Array(mcu.sram.length >> 1);
    this.romMarks = new Uint8Array(0x2000);
    this.onMark = () => 0;
    this.limit = 0; // cycle at which the slice ends; earlier if a peripheral sets an alarm or an interrupt
    this.began = 0; // ns, start of the slice
  }

  /** Sets or clears a mark at `pc`: `onMark` is called before a marked instruction. */
  mark(pc, on) {
    if (pc >= RAM) this.ramMarks[(pc - RAM) >> 1] = on ? 1 : 0;
    else if (pc >= FLASH) this.flashMarks[(pc - FLASH) >> 1] = on ? 1 : 0;
    else this.romMarks[pc >> 1] = on ? 1 : 0;
  }

  /** Ends the slice before the next instruction. */
  yield() {
    this.limit = 0;
  }

  // Accesses outside RAM and flash may read the clock and set alarms and interrupts.
  _before(spent) {
    this.clock.nanosCounter = this.began + spent * this.cycleNs;
  }

  _after() {
    const next = this.clock.nextAlarm;
    if (next !== null) {
      const due = Math.ceil((next.nanos - this.began) / this.cycleNs);
      if (due < this.limit) this.limit = due;
    }
    if (this.core.interruptsUpdated || this.mcu.stopped) this.limit = 0;
  }

  _read(address, bytes, spent) {
    address >>>= 0;
    const offset = address - FLASH;
    if (offset >= 0 && offset < 0x1000000) {
      if (this.cache !== null) this.cache.touch(offset);
      if (bytes === 1) return this.flash8[offset];
      if (bytes === 2) return this.flash16[offset >> 1];
      return (offset & 3) === 0 ? this.flash32[offset >> 2] : this.mcu.readUint32(address) | 0;
    }
    this._before(spent);
    let value = 0;
    if (bytes === 4) value = this.mcu.readUint32(address);
    else value = bytes === 2 ? this.mcu.readUint16(address) : this.mcu.readUint8(address);
    this._after();
    return value | 0;
  }

  _write(address, value, bytes, spent) {
    address >>>= 0;
    this._before(spent);
    if (bytes === 4) this.mcu.writeUint32(address, value >>> 0);
    else if (bytes === 2) this.mcu.writeUint16(address, value & 0xffff);
    else this.mcu.writeUint8(address, value & 0xff);
    this._after();
  }

  /** Executes at least one instruction, up to `limit` cycles; returns the cycles spent. */
  run(limit) {
    const { registers: R, ram8, ram16, ram32, core, cache, cycleNs } = this;
    this.began = this.clock.nanosCounter;
    this.limit = limit;
    let spent = 0, pc = R[PC] & ~1, line = -1;
    let code = this.rom16, marks = this.romMarks, base = 0, size = 0;
    // N and Z are the signs of two results, V that of a third: evaluated only at branches.
    let n = core.N ? -1 : 0, z = core.Z ? 0 : 1, c = core.C ? 1 : 0, v = core.V ? -1 : 0;
    let cached = false;
    do {
      if ((pc - base) >>> 0 >= size) {
        const region = pc >>> 28;
        cached = false;
        if (region === 1) {
          code = this.flash16;
          marks = this.flashMarks;
          base = FLASH;
          size = 0x200000;
          cached = cache !== null;
        } else if (region === 2) {
          code = ram16;
          marks = this.ramMarks;
          base = RAM;
          size = ram8.length;
        } else {
          code = this.rom16;
          marks = this.romMarks;
          base = 0;
          size = 0x4000;
        }
      }
      const at = (pc - base) >> 1;
      if (marks[at] !== 0) {
        R[PC] = pc;
        this._before(spent);
        spent += this.onMark(pc);
        if (R[PC] !== pc || this.limit === 0) {
          pc = R[PC];
          break;
        }
      }
      if (cached && pc >> 3 !== line) {
        line = pc >> 3;
        cache.touch(pc - FLASH);
      }
      const op = code[at];
      pc += 2;
      spent++;
      let a = 0, b = 0, r = 0;
      switch (FORM_OF[op]) {
        case 1: // LSL_I
          a = R[(op >> 3) & 7];
          b = (op >> 6) & 31;
          if (b !== 0) c = (a >>> (32 - b)) & 1;
          n = z = R[op & 7] = a << b;
          break;
        case 2: // LSR_I
          a = R[(op >> 3) & 7];
          b = (op >> 6) & 31;
          c = (a >>> (b === 0 ? 31 : b - 1)) & 1;
          n = z = R[op & 7] = b === 0 ? 0 : a >>> b;
          break;
        case 3: // ASR_I
          a = R[(op >> 3) & 7];
          b = (op >> 6) & 31;
          c = (a >> (b === 0 ? 31 : b - 1)) & 1;
          n = z = R[op & 7] = a >> (b === 0 ? 31 : b);
          break;
        case 4: // ADD_R
          a = R[(op >> 3) & 7];
          b = R[(op >> 6) & 7];
          n = z = r = (a + b) | 0;
          c = r >>> 0 < a >>> 0 ? 1 : 0;
          v = (a ^ r) & (b ^ r);
          R[op & 7] = r;
          break;
        case 5: // SUB_R
          a = R[(op >> 3) & 7];
          b = R[(op >> 6) & 7];
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b >>> 0 ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          R[op & 7] = r;
          break;
        case 6: // ADD_3
          a = R[(op >> 3) & 7];
          b = (op >> 6) & 7;
          n = z = r = (a + b) | 0;
          c = r >>> 0 < a >>> 0 ? 1 : 0;
          v = (a ^ r) & (b ^ r);
          R[op & 7] = r;
          break;
        case 7: // SUB_3
          a = R[(op >> 3) & 7];
          b = (op >> 6) & 7;
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          R[op & 7] = r;
          break;
        case 8: n = z = R[(op >> 8) & 7] = op & 0xff; break; // MOV_I
        case 9: // CMP_I
          a = R[(op >> 8) & 7];
          b = op & 0xff;
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          break;
        case 10: // ADD_8
          a = R[(op >> 8) & 7];
          b = op & 0xff;
          n = z = r = (a + b) | 0;
          c = r >>> 0 < a >>> 0 ? 1 : 0;
          v = (a ^ r) & (b ^ r);
          R[(op >> 8) & 7] = r;
          break;
        case 11: // SUB_8
          a = R[(op >> 8) & 7];
          b = op & 0xff;
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          R[(op >> 8) & 7] = r;
          break;
        case 12: n = z = R[op & 7] &= R[(op >> 3) & 7]; break; // AND
        case 13: n = z = R[op & 7] ^= R[(op >> 3) & 7]; break; // EOR
        case 14: // LSL_R
          a = R[op & 7];
          b = R[(op >> 3) & 7] & 0xff;
          if (b !== 0) c = b <= 32 ? (a >>> (32 - b)) & 1 : 0;
          n = z = R[op & 7] = b < 32 ? a << b : 0;
          break;
        case 15: // LSR_R
          a = R[op & 7];
          b = R[(op >> 3) & 7] & 0xff;
          if (b !== 0) c = b <= 32 ? (a >>> (b - 1)) & 1 : 0;
          n = z = R[op & 7] = b < 32 ? (a >>> b) | 0 : 0;
          break;
        case 16: // ASR_R
          a = R[op & 7];
          b = R[(op >> 3) & 7] & 0xff;
          if (b !== 0) c = (a >> (b < 32 ? b - 1 : 31)) & 1;
          n = z = R[op & 7] = a >> (b < 32 ? b : 31);
          break;
        case 17: // ADC
          a = R[op & 7];
          b = R[(op >> 3) & 7];
          n = z = r = (a + b + c) | 0;
          c = (a >>> 0) + (b >>> 0) + c > 0xffffffff ? 1 : 0;
          v = (a ^ r) & (b ^ r);
          R[op & 7] = r;
          break;
        case 18: // SBC
          a = R[op & 7];
          b = R[(op >> 3) & 7];
          n = z = r = (a - b - 1 + c) | 0;
          c = (a >>> 0) - (b >>> 0) - 1 + c >= 0 ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          R[op & 7] = r;
          break;
        case 19: // ROR
          a = R[op & 7];
          b = R[(op >> 3) & 7] & 0xff;
          if (b !== 0) {
            a = (a >>> (b & 31)) | (a << (32 - (b & 31)));
            c = a >>> 31;
          }
          n = z = R[op & 7] = a;
          break;
        case 20: n = z = R[op & 7] & R[(op >> 3) & 7]; break; // TST
        case 21: b = R[(op >> 3) & 7]; n = z = r = -b | 0; c = b === 0 ? 1 : 0; v = b & r; R[op & 7] = r; break; // RSB
        case 22: // CMP_R
          a = R[op & 7];
          b = R[(op >> 3) & 7];
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b >>> 0 ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          break;
        case 23: // CMN
          a = R[op & 7];
          b = R[(op >> 3) & 7];
          n = z = r = (a + b) | 0;
          c = r >>> 0 < a >>> 0 ? 1 : 0;
          v = (a ^ r) & (b ^ r);
          break;
        case 24: n = z = R[op & 7] |= R[(op >> 3) & 7]; break; // ORR
        case 25: n = z = R[op & 7] = Math.imul(R[op & 7], R[(op >> 3) & 7]); break; // MUL
        case 26: n = z = R[op & 7] &= ~R[(op >> 3) & 7]; break; // BIC
        case 27: n = z = R[op & 7] = ~R[(op >> 3) & 7]; break; // MVN
        case 28: // ADD_H
          b = (op >> 3) & 15;
          b = b === PC ? pc + 2 : R[b];
          a = ((op >> 4) & 8) | (op & 7);
          if (a === PC) {
            pc = (pc + 2 + b) & ~1;
            spent++;
          } else R[a] = a === SP ? (R[SP] + b) & ~3 : R[a] + b;
          break;
        case 29: // CMP_H
          a = R[((op >> 4) & 8) | (op & 7)];
          b = R[(op >> 3) & 15];
          n = z = r = (a - b) | 0;
          c = a >>> 0 >= b >>> 0 ? 1 : 0;
          v = (a ^ b) & (a ^ r);
          break;
        case 30: // MOV_H
          b = (op >> 3) & 15;
          b = b === PC ? pc + 2 : R[b];
          a = ((op >> 4) & 8) | (op & 7);
          if (a === PC) {
            pc = b & ~1;
            spent++;
          } else R[a] = a === SP ? b & ~3 : b;
          break;
        case 31: // BX
          a = R[(op >> 3) & 15];
          if (a >>> 28 === 15) {
            pc -= 2;
            spent = this._rare(pc, spent - 1, n, z, c, v);
            pc = R[PC];
            n = core.N ? -1 : 0; z = core.Z ? 0 : 1; c = core.C ? 1 : 0; v = core.V ? -1 : 0;
            break;
          }
          pc = a & ~1;
          spent++;
          break;
        case 32: a = R[(op >> 3) & 15]; R[LR] = pc | 1; pc = a & ~1; spent++; break; // BLX
        case 33: // LDR_L
          a = ((pc + 2) & ~3) + ((op & 0xff) << 2);
          spent++;
          if (base === FLASH) {
            if (cached && a >> 3 !== line) {
              cache.touch(a - FLASH);
              line = -1;
            }
            R[(op >> 8) & 7] = this.flash32[(a - FLASH) >> 2];
          } else R[(op >> 8) & 7] = base === RAM ? ram32[(a - RAM) >> 2] : this._read(a, 4, spent);
          break;
        case 34: // STR_R
        case 42: // STR_I
        case 48: // STR_S
          r = FORM_OF[op];
          if (r === 48) {
            a = R[SP] + ((op & 0xff) << 2);
            b = R[(op >> 8) & 7];
          } else {
            a = R[(op >> 3) & 7] + (r === 34 ? R[(op >> 6) & 7] : ((op >> 6) & 31) << 2);
            b = R[op & 7];
          }
          spent++;
          if ((a - RAM) >>> 0 < ram8.length && (a & 3) === 0) ram32[(a - RAM) >> 2] = b;
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 3 : 0;
            this._write(a, b, 4, spent);
          }
          break;
        case 35: // STRH_R
        case 46: // STRH_I
          a = R[(op >> 3) & 7] + (FORM_OF[op] === 35 ? R[(op >> 6) & 7] : ((op >> 6) & 31) << 1);
          spent++;
          if ((a - RAM) >>> 0 < ram8.length) ram16[(a - RAM) >> 1] = R[op & 7];
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 3 : 0;
            this._write(a, R[op & 7], 2, spent);
          }
          break;
        case 36: // STRB_R
        case 44: // STRB_I
          a = R[(op >> 3) & 7] + (FORM_OF[op] === 36 ? R[(op >> 6) & 7] : (op >> 6) & 31);
          spent++;
          if ((a - RAM) >>> 0 < ram8.length) ram8[a - RAM] = R[op & 7];
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 3 : 0;
            this._write(a, R[op & 7], 1, spent);
          }
          break;
        case 38: // LDR_R
        case 43: // LDR_I
        case 49: // LDR_S
          r = FORM_OF[op];
          if (r === 49) a = R[SP] + ((op & 0xff) << 2);
          else a = R[(op >> 3) & 7] + (r === 38 ? R[(op >> 6) & 7] : ((op >> 6) & 31) << 2);
          spent++;
          if ((a - RAM) >>> 0 < ram8.length && (a & 3) === 0) b = ram32[(a - RAM) >> 2];
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 2 : 0;
            b = this._read(a, 4, spent);
            line = -1;
          }
          R[r === 49 ? (op >> 8) & 7 : op & 7] = b;
          break;
        case 39: // LDRH_R
        case 47: // LDRH_I
        case 41: // LDRSH
          r = FORM_OF[op];
          a = R[(op >> 3) & 7] + (r === 47 ? ((op >> 6) & 31) << 1 : R[(op >> 6) & 7]);
          spent++;
          if ((a - RAM) >>> 0 < ram8.length) b = ram16[(a - RAM) >> 1];
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 2 : 0;
            b = this._read(a, 2, spent);
            line = -1;
          }
          R[op & 7] = r === 41 ? (b << 16) >> 16 : b;
          break;
        case 40: // LDRB_R
        case 45: // LDRB_I
        case 37: // LDRSB
          r = FORM_OF[op];
          a = R[(op >> 3) & 7] + (r === 45 ? (op >> 6) & 31 : R[(op >> 6) & 7]);
          spent++;
          if ((a - RAM) >>> 0 < ram8.length) b = ram8[a - RAM];
          else {
            spent += a >>> 28 === SIO ? -1 : a >>> 28 === APB ? 2 : 0;
            b = this._read(a, 1, spent);
            line = -1;
          }
          R[op & 7] = r === 37 ? (b << 24) >> 24 : b;
          break;
        case 50: R[(op >> 8) & 7] = ((pc + 2) & ~3) + ((op & 0xff) << 2); break; // ADR
        case 51: R[(op >> 8) & 7] = R[SP] + ((op & 0xff) << 2); break; // ADD_S
        case 52: R[SP] += (op & 0x7f) << 2; break; // INC_S
        case 53: R[SP] -= (op & 0x7f) << 2; break; // DEC_S
        case 54: R[op & 7] = (R[(op >> 3) & 7] << 16) >> 16; break; // SXTH
        case 55: R[op & 7] = (R[(op >> 3) & 7] << 24) >> 24; break; // SXTB
        case 56: R[op & 7] = R[(op >> 3) & 7] & 0xffff; break; // UXTH
        case 57: R[op & 7] = R[(op >> 3) & 7] & 0xff; break; // UXTB
        case 58: // PUSH
          a = R[SP];
          if (op & 0x100) {
            a -= 4;
            ram32[(a - RAM) >> 2] = R[LR];
            spent++;
          }
          for (b = 7; b >= 0; b--) {
            if (op & (1 << b)) {
              a -= 4;
              ram32[(a - RAM) >> 2] = R[b];
              spent++;
            }
          }
          R[SP] = a;
          break;
        case 59: // POP
          a = R[SP];
          if (op & 0x100) {
            // An EXC_RETURN value is above all other addresses.
            for (b = op & 0xff, r = a; b !== 0; b &= b - 1) r += 4;
            if (ram32[(r - RAM) >> 2] >>> 28 === 15) {
              pc -= 2;
              spent = this._rare(pc, spent - 1, n, z, c, v);
              pc = R[PC];
              n = core.N ? -1 : 0; z = core.Z ? 0 : 1; c = core.C ? 1 : 0; v = core.V ? -1 : 0;
              break;
            }
          }
          for (b = 0; b < 8; b++) {
            if (op & (1 << b)) {
              R[b] = ram32[(a - RAM) >> 2];
              a += 4;
              spent++;
            }
          }
          if (op & 0x100) {
            pc = ram32[(a - RAM) >> 2] & ~1;
            a += 4;
            spent += 3;
          }
          R[SP] = a;
          break;
        case 60: // REV
          a = R[(op >> 3) & 7];
          R[op & 7] = (a << 24) | ((a & 0xff00) << 8) | ((a >>> 8) & 0xff00) | (a >>> 24);
          break;
        case 61:  break; // NOP
        case 62: // STM
          a = R[(op >> 8) & 7];
          for (b = 0; b < 8; b++) {
            if (op & (1 << b)) {
              spent++;
              if ((a - RAM) >>> 0 < ram8.length) ram32[(a - RAM) >> 2] = R[b];
              else this._write(a, R[b], 4, spent);
              a += 4;
            }
          }
          R[(op >> 8) & 7] = a;
          break;
        case 63: // LDM
          r = (op >> 8) & 7;
          a = R[r];
          for (b = 0; b < 8; b++) {
            if (op & (1 << b)) {
              spent++;
              if ((a - RAM) >>> 0 < ram8.length) R[b] = ram32[(a - RAM) >> 2];
              else {
                R[b] = this._read(a, 4, spent);
                line = -1;
              }
              a += 4;
            }
          }
          if (!(op & (1 << r))) R[r] = a;
          break;
        case 64: if (z === 0) { pc += jump(op); spent++; } break; // BEQ
        case 65: if (z !== 0) { pc += jump(op); spent++; } break; // BNE
        case 66: if (c !== 0) { pc += jump(op); spent++; } break; // BCS
        case 67: if (c === 0) { pc += jump(op); spent++; } break; // BCC
        case 68: if (n < 0) { pc += jump(op); spent++; } break; // BMI
        case 69: if (n >= 0) { pc += jump(op); spent++; } break; // BPL
        case 70: if (v < 0) { pc += jump(op); spent++; } break; // BVS
        case 71: if (v >= 0) { pc += jump(op); spent++; } break; // BVC
        case 72: if (c !== 0 && z !== 0) { pc += jump(op); spent++; } break; // BHI
        case 73: if (c === 0 || z === 0) { pc += jump(op); spent++; } break; // BLS
        case 74: if ((n ^ v) >= 0) { pc += jump(op); spent++; } break; // BGE
        case 75: if ((n ^ v) < 0) { pc += jump(op); spent++; } break; // BLT
        case 76: if (z !== 0 && (n ^ v) >= 0) { pc += jump(op); spent++; } break; // BGT
        case 77: if (z === 0 || (n ^ v) < 0) { pc += jump(op); spent++; } break; // BLE
        case 78: pc += ((op << 21) >> 20) + 2; spent++; break; // B
        case 79: // BL
          b = code[at + 1];
          if (b >> 14 === 3 && b & 0x1000) {
            if (cached && pc >> 3 !== line) {
              line = pc >> 3;
              cache.touch(pc - FLASH);
            }
            a = (op >> 10) & 1;
            r = ((op & 0x3ff) << 12) | ((b & 0x7ff) << 1);
            r |= ((1 ^ a ^ ((b >> 13) & 1)) << 23) | ((1 ^ a ^ ((b >> 11) & 1)) << 22);
            R[LR] = (pc + 2) | 1;
            pc = (pc + 2 + (a ? r | 0xff000000 : r)) | 0;
            spent += 2;
            break;
          }
        // falls through: a special register or a barrier
        default:
          pc -= 2;
          spent = this._rare(pc, spent - 1, n, z, c, v);
          pc = R[PC];
          n = core.N ? -1 : 0; z = core.Z ? 0 : 1; c = core.C ? 1 : 0; v = core.V ? -1 : 0;
      }
      if (cached && cache.stall !== 0) {
        spent += cache.stall;
        cache.stall = 0;
      }
    } while (spent < this.limit);
    R[PC] = pc;
    core.N = n < 0;
    core.Z = z === 0;
    core.C = c !== 0;
    core.V = v < 0;
    this.clock.nanosCounter = this.began;
    return spent;
  }

  // Executes one instruction by rp2040js; ends the slice if it slept, switched mode or took an interrupt.
  _rare(pc, spent, n, z, c, v) {
    const { core, registers: R } = this;
    R[PC] = pc;
    core.N = n < 0;
    core.Z = z === 0;
    core.C = c !== 0;
    core.V = v < 0;
    this._before(spent);
    spent += core.executeInstruction();
    this._after();
    if (core.waiting) this.limit = 0;
    return spent;
  }
}
