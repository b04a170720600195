// The I2C controllers: transfers, instantaneous in rp2040js, take the time of their bits here, with the chips of the board.

// From rp2040js: state of the controller, its enable register, its interrupt for an empty queue.
const IDLE = 0, ENABLE_REGISTER = 0x6c, SPIKES_REGISTER = 0xa0, ENABLED = 1, ABORTED = 2, QUEUE_EMPTY = 1 << 4;
const READING = 1, I2C_FUNCTION = 3, FIRST_RESERVED_PIN = 30;
const BYTE_BITS = 9, ETIMEDOUT = 110; // as hypercall.py has it

export class I2cController {
  /**
   * bus: an RPI2C of `mcu`, number 0 or 1; line: to the board, whose bus it is.
   * pins: a Pins, told which ones are the bus.
   */
  constructor(mcu, number, line, pins) {
    this._mcu = mcu;
    this._bus = mcu.i2c[number];
    this._number = number;
    this._line = line;
    this._pins = pins;
    this._then = null;
    this._alarm = mcu.clock.createAlarm(() => this._then());
    this._written = []; // bytes of the current transfer, sent to the chip at the next condition
    this._held = false; // SDA is held low: no start condition until the controller is disabled
    this._settings = "";
    this._spikes = 7; // cycles; rp2040js takes even numbers only
    this._wire();
  }

  // RP2040 data sheet, 4.3.14.1; slower than the 400 kHz assumed by the SDK. Edges take no time here.
  get _bitNs() {
    const high = this._bus.sclHighPeriod + this._spikes + 7, low = this._bus.sclLowPeriod + 1;
    return ((high + low) * 1e9) / this._mcu.clkSys;
  }

  _later(bits, then) {
    this._then = then;
    this._alarm.schedule(bits * this._bitNs);
  }

  _wire() {
    const bus = this._bus, line = this._line, op = line.op, number = this._number;
    bus.onStart = () => this._later(1, () => bus.completeStart());
    bus.onConnect = (address, mode) => {
      let status = 0;
      line.begin(op.I2C_START, number, [address, mode === READING ? 1 : 0, ...this._written], (s) => (status = s));
      this._written = [];
      this._later(BYTE_BITS, () => {
        line.settle();
        if (status === -ETIMEDOUT) {
          this._held = true;
          this._pins.look();
        } else bus.completeConnect(status > 0);
      });
    };
    bus.onWriteByte = (value) => {
      this._written.push(value);
      this._later(BYTE_BITS, () => bus.completeWrite(true));
    };
    bus.onReadByte = () => {
      let value = 0xff;
      line.begin(op.I2C_TAKE, number, [], (byte) => (value = byte));
      this._later(BYTE_BITS, () => {
        line.settle();
        bus.completeRead(value);
      });
    };
    bus.onStop = () => {
      if (this._written.length) {
        line.begin(op.I2C_PUT, number, this._written, () => {});
        this._written = [];
      }
      this._later(1, () => bus.completeStop());
    };
    // An abort empties the queue; the SDK waits for its flag.
    const abort = bus.abort.bind(bus);
    bus.abort = (reason) => {
      abort(reason);
      bus.setInterrupts(QUEUE_EMPTY);
    };
    const write = bus.writeUint32.bind(bus);
    bus.writeUint32 = (offset, value) => {
      if (offset === ENABLE_REGISTER && this._held && (!(value & ENABLED) || value & ABORTED)) this._letGo();
      write(offset, value);
      if (offset === SPIKES_REGISTER) this._spikes = value & 0xff;
      if (offset === ENABLE_REGISTER && value & ENABLED) this._tellSettings();
    };
  }

  _letGo() {
    this._held = false;
    this._alarm.cancel();
    this._bus.state = IDLE;
    this._bus.busy = false;
  }

  // Even pins are SDA, odd ones SCL, in pairs that alternate between the two controllers: RP2040 data sheet, 1.4.3.
  _tellSettings() {
    const pins = [];
    for (let k = 0; k < FIRST_RESERVED_PIN; k++) {
      if (this._mcu.gpio[k].functionSelect === I2C_FUNCTION && ((k >> 1) & 1) === this._number) pins.push(k);
    }
    const sda = pins.find((k) => k % 2 === 0) ?? -1, scl = pins.find((k) => k % 2 === 1) ?? -1;
    const payload = Buffer.alloc(6);
    payload.writeUInt32LE(Math.round(1e9 / this._bitNs), 0);
    payload.writeInt8(scl, 4);
    payload.writeInt8(sda, 5);
    const settings = payload.toString("hex");
    if (settings === this._settings || scl < 0) return;
    this._settings = settings;
    this._line.ask(this._line.op.I2C_INIT, this._number, payload);
    this._pins.watch(scl, sda);
  }
}
