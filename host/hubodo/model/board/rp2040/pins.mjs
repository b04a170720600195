// The two pins of the bus when the firmware moves them by hand, and the analogue ones: both ask the board.

const SIO_FUNCTION = 5, OPEN_DRAIN = 2, NO_PULL = 0xff;
const DRIVEN_LOW = 0; // a GPIOPinState of rp2040js

export class Pins {
  /** mcu: an RP2040; line: to the board. */
  constructor(mcu, line) {
    this._mcu = mcu;
    this._line = line;
    this._watched = [];
    this._levels = new Map();
    const adc = mcu.adc, read = adc.onADCRead;
    adc.onADCRead = (channel) => {
      line.ask(line.op.ADC_READ, channel);
      adc.channelValues[channel] = line.payload.readUInt16LE(0) >> 4;
      read(channel);
    };
  }

  /** The bus is on these pins from now on. */
  watch(scl, sda) {
    for (const stop of this._watched) stop();
    this._watched = [];
    for (const pin of [scl, sda]) {
      const gpio = this._mcu.gpio[pin];
      this._levels.set(pin, 1);
      gpio.setInputValue(true);
      this._watched.push(gpio.addListener((state) => this._moved(pin, state === DRIVEN_LOW ? 0 : 1, scl, sda)));
    }
  }

  _moved(pin, level, scl, sda) {
    const { op } = this._line, gpio = this._mcu.gpio;
    if (gpio[pin].functionSelect !== SIO_FUNCTION || this._levels.get(pin) === level) return;
    this._levels.set(pin, level);
    this._line.ask(op.PIN_INIT, pin, [OPEN_DRAIN, NO_PULL]);
    this._line.ask(op.PIN_SET, pin, [level]);
    gpio[scl].setInputValue(this._levels.get(scl) === 1);
    gpio[sda].setInputValue(this._levels.get(sda) === 1 && this._line.ask(op.PIN_GET, sda) === 1);
  }
}
