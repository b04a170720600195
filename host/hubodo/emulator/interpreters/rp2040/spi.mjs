// The SPI controllers: each byte takes the time of its bits and is exchanged with the board, which also sees the selects.

const CONTROL_1 = 0x04, SIO_FUNCTION = 5, FIRST_RESERVED_PIN = 30;
const ENABLED = 1 << 1; // of CONTROL_1, RP2040 data sheet, 4.4.4
const LOW = 0, HIGH = 1; // GPIOPinState of rp2040js
const BYTE_BITS = 8;

export class SpiController {
  /** mcu: an RP2040; number: of its controller, 0 or 1; line: to the board; pins: a Pins. */
  constructor(mcu, number, line, pins) {
    const spi = mcu.spi[number];
    let byte = 0;
    const alarm = mcu.clock.createAlarm(() => {
      line.settle();
      spi.completeTransmit(byte);
    });
    spi.onTransmit = (value) => {
      line.begin(line.op.SPI, number, [value & 0xff], (status, payload) => (byte = status > 0 ? payload[0] : 0));
      alarm.schedule((BYTE_BITS * 1e9) / spi.clockFrequency);
    };
    const write = spi.writeUint32.bind(spi);
    spi.writeUint32 = (offset, value) => {
      write(offset, value);
      if (offset === CONTROL_1 && value & ENABLED) pins.watchSelects();
    };
  }
}

/** Calls `moved(pin, level)` for each pin of `mcu` that the firmware drives to another level. */
export function watchOutputs(mcu, moved) {
  const levels = new Map();
  for (let pin = 0; pin < FIRST_RESERVED_PIN; pin++) {
    mcu.gpio[pin].addListener((state) => {
      if (state !== LOW && state !== HIGH) return;
      if (mcu.gpio[pin].functionSelect !== SIO_FUNCTION || levels.get(pin) === state) return;
      levels.set(pin, state);
      moved(pin, state);
    });
  }
}
