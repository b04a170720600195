// The USB cable and the host: enumerates the device, opens and closes the port, accepts packets when it has space.
import { USBCDC } from "rp2040js";
import { FLAG_INPUT, FLAG_OPEN, FLAG_PLUGGED, FLAG_ROOM } from "../pipe.mjs";

const PACKET = 64, PACKET_NS = 60e3; // a full-speed bulk packet with its handshake and the host's scheduling
const READ_AT_ONCE = 1024;
const AVAILABLE = 1 << 10, IN_CONTROL = 0x80, OUT_CONTROL = 4;
const SIE_STATUS = 0x50, SUSPENDED = 1 << 4;
const DTR = 1, RTS = 2;

// rp2040js enumerates a CDC device; it raises both lines as soon as that is done.
class Cdc extends USBCDC {
  open = false;
  asking = false; // the device has not acknowledged yet
  constructor(usb) {
    super(usb);
    const written = usb.onEndpointWrite;
    usb.onEndpointWrite = (endpoint, data) => {
      if (endpoint === 0 && data.length === 0) this.asking = false;
      written(endpoint, data);
    };
  }
  cdcSetControlLineState() {
    this.asking = true;
    super.cdcSetControlLineState(this.open ? DTR | RTS : 0);
  }
}

export class UsbHost {
  /** mcu: an RP2040; line: to the board, whose link the host is. */
  constructor(mcu, line) {
    this._mcu = mcu;
    this._usb = mcu.usbCtrl;
    this._line = line;
    this._input = []; // bytes from the host that the device has not read yet
    this._room = 0; // free bytes of the receive buffer of the device
    this._held = null; // [offset, value]: a packet that the host does not accept yet
    this._plugged = false;
    this._enabled = false; // by the firmware
    this._alarm = mcu.clock.createAlarm(() => this._offer());
    this._usb.readDelayMicroseconds = PACKET_NS / 1000;
    this._usb.writeDelayMicroseconds = 0;
    this._wire();
  }

  _wire() {
    const usb = this._usb;
    const updated = usb.DPRAMUpdated.bind(usb), write = usb.writeUint32.bind(usb);
    // rp2040js completes a packet at once; here it completes when the host accepts it.
    usb.DPRAMUpdated = (offset, value) => {
      const endpoint = (offset - IN_CONTROL) >> 3;
      if (value & AVAILABLE && !(offset & OUT_CONTROL) && endpoint === this._cdc?.inEndpoint) {
        this._held = [offset, value];
        this._alarm.schedule(PACKET_NS);
      } else updated(offset, value);
    };
    this._deliver = updated;
    usb.writeUint32 = (offset, value) => {
      // Writing ones clears it, which rp2040js omits.
      if (offset === SIE_STATUS) usb.sieStatus &= ~(usb.rawWriteValue & SUSPENDED);
      write(offset, value);
    };
    this._attach();
  }

  // A newly attached device is enumerated again.
  _attach() {
    const usb = this._usb, cdc = new Cdc(usb);
    this._cdc = cdc;
    this._held = null;
    this._room = 0;
    this._input = [];
    this._configured = false;
    usb.onUSBEnabled = () => {
      this._enabled = true;
      if (this._plugged) usb.resetDevice();
    };
    usb.onEndpointRead = (endpoint, size) => {
      if (endpoint !== cdc.outEndpoint) return;
      this._room = size;
      this._give();
    };
    cdc.open = (this._line.flags & FLAG_OPEN) !== 0;
    cdc.onDeviceConnected = () => (this._configured = true);
    cdc.onSerialData = (data) => {
      const line = this._line;
      for (let at = 0; at < data.length; at += PACKET) line.ask(line.op.WRITE, 0, data.subarray(at, at + PACKET));
    };
  }

  _offer() {
    const wanted = FLAG_PLUGGED | FLAG_OPEN | FLAG_ROOM;
    if (this._held === null || (this._line.flags & wanted) !== wanted) return;
    const [offset, value] = this._held;
    this._held = null;
    this._deliver(offset, value);
  }

  _give() {
    if (!this._room || !this._input.length) return;
    const packet = Uint8Array.from(this._input.splice(0, Math.min(this._room, PACKET)));
    this._room = 0;
    this._usb.endpointReadDone(this._cdc.outEndpoint, packet);
  }

  /** Polls the state of the link: cable, port, bytes. */
  refresh() {
    const line = this._line;
    const plugged = (line.flags & FLAG_PLUGGED) !== 0;
    if (plugged !== this._plugged) {
      this._plugged = plugged;
      if (plugged) {
        this._attach();
        if (this._enabled) this._usb.resetDevice();
      } else if (this._enabled) {
        this._configured = false;
        this._usb.sieStatus |= SUSPENDED;
        this._usb.sieStatusUpdated();
      }
    }
    if (!this._configured) return;
    const open = (line.flags & FLAG_OPEN) !== 0;
    if (open !== this._cdc.open && !this._cdc.asking) {
      this._cdc.open = open;
      this._cdc.cdcSetControlLineState();
    }
    this._offer();
    if (line.flags & FLAG_INPUT && this._input.length < PACKET) {
      const most = Buffer.alloc(8);
      most.writeUInt32LE(READ_AT_ONCE, 0);
      line.ask(line.op.READ, 0, most);
      for (const byte of line.payload) this._input.push(byte);
    }
    this._give();
  }
}
