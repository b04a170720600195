// The flash chip: a file with its programmed contents at every moment, written by the routines of the bootrom.
import fs from "node:fs";

const SECTOR = 4096, PAGE = 256;
// W25Q16JV data sheet, 9.6, typical: erasing a sector, programming a page.
const ERASE_NS = 45e6, PROGRAM_NS = 0.4e6;
const UNIQUE_ID = 0x4b, UNIQUE_ID_AT = 5;
const ROM_TABLE_AT = 0x14;
const SSI = 0x18000, ENABLED = 0x08, RECEIVED = 0x24, DATA = 0x60;
const IO_QSPI = 0x40018, SELECT_CONTROL = 0x0c, OVERRIDE = 0x300, DRIVEN_LOW = 0x200;

/** Addresses of bootrom routines by their two-letter codes: RP2040 data sheet, 2.8.3. */
export function romRoutines(rom) {
  const found = {};
  for (let at = rom.readUInt16LE(ROM_TABLE_AT); rom.readUInt16LE(at) !== 0; at += 4) {
    found[rom.toString("latin1", at, at + 2)] = rom.readUInt16LE(at + 2) & ~1;
  }
  return found;
}

export class Flash {
  /** path: image of the chip; uniqueId: hexadecimal, 8 bytes; rom: the bootrom (Buffer). */
  constructor(path, uniqueId, rom) {
    this._file = fs.openSync(path, "r+");
    this.contents = fs.readFileSync(path);
    this._id = Buffer.from(uniqueId, "hex");
    const { RE, RP } = romRoutines(rom);
    this.eraseAt = RE;
    this.programAt = RP;
    this.erased = this.programmed = 0;
  }

  /** Loads the contents into a new RP2040 and connects its serial interface. */
  plug(mcu) {
    this._memory = mcu.flash;
    mcu.flash.set(this.contents);
    this._answerCommands(mcu);
  }

  /**
   * One page or sector of the bootrom routine at core.PC, then back to its caller once all are done.
   * Answers how long the chip is busy with it, ns: a board that loses power meanwhile has the rest as it was.
   */
  serve(core) {
    const R = core.registers;
    let busy = 0;
    if (R[1] > 0 && core.PC === this.eraseAt) {
      this._memory.fill(0xff, R[0], R[0] + SECTOR);
      this._keep(R[0], SECTOR);
      R[0] += SECTOR;
      R[1] -= Math.min(SECTOR, R[1]);
      this.erased++;
      busy = ERASE_NS;
    } else if (R[2] > 0 && core.PC === this.programAt) {
      for (let k = 0; k < PAGE; k++) this._memory[R[0] + k] &= core.readUint8(R[1] + k);
      this._keep(R[0], PAGE);
      R[0] += PAGE;
      R[1] += PAGE;
      R[2] -= Math.min(PAGE, R[2]);
      this.programmed++;
      busy = PROGRAM_NS;
    } else core.PC = core.LR & ~1;
    return busy;
  }

  _keep(at, bytes) {
    this.contents.set(this._memory.subarray(at, at + bytes), at);
    fs.writeSync(this._file, this.contents, at, bytes, at);
  }

  // The serial interface returns a byte for each byte sent; the unique id is read while chip select is low.
  _answerCommands(mcu) {
    const ssi = mcu.peripherals[SSI], select = mcu.peripherals[IO_QSPI];
    let answers = [], sent = -1, command = 0, control = 0;
    select.writeUint32 = (offset, value) => {
      if (offset !== SELECT_CONTROL) return;
      control = value;
      sent = (value & OVERRIDE) === DRIVEN_LOW ? 0 : -1;
    };
    select.readUint32 = (offset) => (offset === SELECT_CONTROL ? control : 0);
    const write = ssi.writeUint32.bind(ssi), read = ssi.readUint32.bind(ssi);
    ssi.writeUint32 = (offset, value) => {
      if (offset === ENABLED && value === 0) answers = [];
      if (offset !== DATA) return write(offset, value);
      if (sent === 0) command = value & 0xff;
      answers.push(command === UNIQUE_ID && sent >= UNIQUE_ID_AT ? this._id[sent - UNIQUE_ID_AT] ?? 0 : 0);
      if (sent >= 0) sent++;
    };
    ssi.readUint32 = (offset) => {
      if (offset === DATA) return answers.shift() ?? 0;
      return offset === RECEIVED ? answers.length : read(offset);
    };
  }
}
