// Device files of the board modules: buffers are transferred without allocation.
import { HEADER } from "../pipe.mjs";

const MEM = 0;
const file = { open() {}, close() {}, llseek: () => 0 };

class I2c {
  constructor(board) {
    this.board = board;
    this.aim(0, 0, 0, 1);
  }

  aim(busMode, to, memory, bytes) {
    this.target = busMode >> 1;
    this.mode = busMode & 1;
    this.address = to;
    this.register = memory;
    this.addressBytes = bytes;
  }

  head() {
    const { request, view } = this.board;
    request[HEADER] = this.address;
    request[HEADER + 1] = this.addressBytes;
    view.setUint16(HEADER + 2, this.register, true);
  }
}

/** Devices of `machine`, `socket` and the standard streams, and their transfer targets. */
export class Devices {
  constructor(board) {
    this.board = board;
    this.i2c = new I2c(board);
    this.result = 0;
    this.port = this.readTimeout = 0;
    this.socket = this.spiUnit = 0;
    this.armed = false;
    this.peer = Buffer.alloc(6);
  }

  register(FS) {
    [["i2c", this._i2c()], ["serial", this._serial()], ["udp", this._udp()], ["spi", this._exchange("SPI")], ["espnow", this._exchange("ESPNOW")], ["ble", this._exchange("BLE")]].forEach(([name, device], k) => {
      FS.registerDevice(FS.makedev(64, k), { ...file, ...device });
      FS.mkdev(`/dev/${name}`, FS.makedev(64, k));
    });
  }

  _i2c() {
    const { board, i2c } = this, { op } = board;
    return {
      read: (_stream, buffer, offset, length) => {
        if (this.result < 0) return 0;
        i2c.head();
        board.view.setUint16(HEADER + 4, length, true);
        this.result = board.ask(i2c.mode === MEM ? op.I2C_READ_MEM : op.I2C_READ, i2c.target, 6);
        if (this.result < 0) return 0;
        buffer.set(board.payload, offset);
        return board.payload.length;
      },
      write: (_stream, buffer, offset, length) => {
        i2c.head();
        board.request.set(buffer.subarray(offset, offset + length), HEADER + 4);
        this.result = board.ask(i2c.mode === MEM ? op.I2C_WRITE_MEM : op.I2C_WRITE, i2c.target, 4 + length);
        return length;
      },
    };
  }

  _serial() {
    const { board } = this;
    return {
      read: (_stream, buffer, offset, length) => {
        const got = board.get(this.port, length, this.readTimeout);
        buffer.set(got, offset);
        return got.length;
      },
      write: (_stream, buffer, offset, length) => {
        board.request.set(buffer.subarray(offset, offset + length), HEADER);
        return board.ask(board.op.WRITE, this.port, length);
      },
    };
  }

  // A write is sent at once; the data received meanwhile, or the reply, can be read once.
  _exchange(name) {
    const { board } = this;
    let came = Buffer.alloc(0);
    return {
      read: (_stream, buffer, offset, length) => {
        const taken = came.subarray(0, length);
        buffer.set(taken, offset);
        came = came.subarray(taken.length);
        return taken.length;
      },
      write: (_stream, buffer, offset, length) => {
        board.request.set(buffer.subarray(offset, offset + length), HEADER);
        this.result = board.ask(board.op[name], this.spiUnit, length);
        came = Buffer.from(board.payload);
        return length;
      },
    };
  }

  _udp() {
    const { board, peer } = this, { op } = board;
    return {
      // readinto repeats until its buffer is full: one datagram, then end of file.
      read: (_stream, buffer, offset, length) => {
        if (!this.armed) return 0;
        this.armed = false;
        board.view.setUint32(HEADER, length, true);
        board.view.setInt32(HEADER + 4, this.readTimeout, true);
        this.result = board.ask(op.UDP_RECV, this.socket, 8);
        if (this.result < 0) return 0;
        const { payload } = board;
        payload.copy(peer, 0, 0, 6);
        buffer.set(payload.subarray(6), offset);
        return payload.length - 6;
      },
      write: (_stream, buffer, offset, length) => {
        peer.copy(board.request, HEADER);
        board.request.set(buffer.subarray(offset, offset + length), HEADER + 6);
        this.result = board.ask(op.UDP_SEND, this.socket, 6 + length);
        return length;
      },
    };
  }

  /** Functions that MicroPython calls before and after it reads or writes. */
  forModule() {
    const { peer } = this;
    return {
      i2c_to: (busMode, to, memory, bytes) => {
        this.i2c.aim(busMode, to, memory, bytes);
        this.result = 0;
      },
      result: () => this.result,
      serial_to: (port, timeoutMs) => {
        this.port = port;
        this.readTimeout = timeoutMs;
      },
      spi_to: (unit) => {
        this.spiUnit = unit;
      },
      udp_destination: (handle, high, low, remote) => {
        this.socket = handle;
        this.result = 0;
        peer.writeUInt16BE(high, 0);
        peer.writeUInt16BE(low, 2);
        peer.writeUInt16LE(remote, 4);
      },
      udp_from: (handle, timeoutMs) => {
        this.socket = handle;
        this.readTimeout = timeoutMs;
        this.armed = true;
        this.result = 0;
      },
      udp_peer: (k) => (k < 4 ? peer[k] : peer.readUInt16LE(4)),
    };
  }
}
