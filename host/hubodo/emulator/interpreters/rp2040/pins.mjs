// Bus pins and selects that the firmware drives directly, and analogue pins: all query the board.
import { watchOutputs } from "./spi.mjs";

const SIO_FUNCTION = 5, OUTPUT = 1, OPEN_DRAIN = 2, NO_PULL = 0xff;
const DRIVEN_LOW = 0; // a GPIOPinState of rp2040js

export class Pins {
  /** mcu: an RP2040; line: to the board. */
  constructor(mcu, line) {
    this._mcu = mcu;
    this._line = line;
    this._bus = [];
    this._watched = [];
    this._levels = new Map();
    this._selects = false;
    const adc = mcu.adc, read = adc.onADCRead;
    adc.onADCRead = (channel) => {
      line.ask(line.op.ADC_READ, channel);
      adc.channelValues[channel] = line.payload.readUInt16LE(0) >> 4;
      read(channel);
    };
  }

  /** Sets the pins of the bus. */
  watch(scl, sda) {
    for (const stop of this._watched) stop();
    this._bus = [scl, sda];
    this._watched = this._bus.map((pin) => {
      this._levels.set(pin, 1);
      return this._mcu.gpio[pin].addListener((state) => this._moved(pin, state === DRIVEN_LOW ? 0 : 1));
    });
    this.look();
  }

  /** Passes the levels of all other driven pins to the board, whose selects are among them. */
  watchSelects() {
    if (this._selects) return;
    this._selects = true;
    watchOutputs(this._mcu, (pin, level) => {
      if (this._bus.includes(pin)) return;
      this._line.ask(this._line.op.PIN_INIT, pin, [OUTPUT, NO_PULL]);
      this._line.ask(this._line.op.PIN_SET, pin, [level]);
    });
  }

  /** Sets the input levels of the bus pins: high unless a chip holds one low. */
  look() {
    const [scl, sda] = this._bus, line = this._line;
    this._mcu.gpio[scl].setInputValue(this._levels.get(scl) === 1);
    this._mcu.gpio[sda].setInputValue(this._levels.get(sda) === 1 && line.ask(line.op.PIN_GET, sda) === 1);
  }

  _moved(pin, level) {
    const line = this._line;
    if (this._mcu.gpio[pin].functionSelect !== SIO_FUNCTION || this._levels.get(pin) === level) return;
    this._levels.set(pin, level);
    line.ask(line.op.PIN_INIT, pin, [OPEN_DRAIN, NO_PULL]);
    line.ask(line.op.PIN_SET, pin, [level]);
    this.look();
  }
}
