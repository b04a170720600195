"""Requests of the host and their answers."""

import struct
from time import ticks_us

import reports
from bias_initialiser import MIN_SAMPLES
from framing import PAYLOAD
from micropython import const
from wire import (
    ACK,
    ACK_FORMAT,
    ACK_SIZE,
    BIAS_INIT,
    BIAS_INIT_SIZE,
    FILTER_STATE_INITIALISING,
    GET_HELLO,
    NACK,
    NACK_FORMAT,
    NACK_SIZE,
    PING,
    REASON_BAD_VALUE,
    REASON_BUSY,
    REASON_NO_IMU,
    REASON_UNKNOWN_MESSAGE,
    REBOOT,
    REBOOT_MODE_REPL,
    REBOOT_SIZE,
    SET_CONFIG,
    SET_CONFIG_FORMAT,
    SET_CONFIG_SIZE,
    START,
    STOP,
    TIME_REPLY,
    TIME_REPLY_SIZE,
    TIME_REQUEST,
    TIME_REQUEST_SIZE,
)

_UPDATE_START = const(0x49)
"""UPDATE_START of `radio/wire_update.py`, which is loaded with the first of these requests alone."""


class Commands:
    """Executes requests on `node`; each is answered exactly once."""

    def __init__(self, node):
        self._node = node
        self._bias_seq = -1

    def handle(self, frame, received_us):
        """Answer the request in a FrameReader; requests to other nodes are ignored, 0 is any."""
        node = self._node
        if frame.node and frame.node != node.outbox.node_id:
            return
        request, seq, raw, size = frame.type_id, frame.seq, frame.raw, frame.size
        if request == TIME_REQUEST and size >= TIME_REQUEST_SIZE:
            self._reply_time(raw, received_us)
        elif request == PING:
            self.ack(request, seq)
        elif request == GET_HELLO:
            reports.hello(node)
        elif request == START:
            node.start()
            if node.parts.chip is None:
                self.nack(request, seq, REASON_NO_IMU, node.parts.faults)
            else:
                self.ack(request, seq)
        elif request == STOP:
            node.stop()
            self.ack(request, seq)
        elif request == BIAS_INIT and size >= BIAS_INIT_SIZE:
            self._start_bias(seq, raw[PAYLOAD] | raw[PAYLOAD + 1] << 8)
        elif request == SET_CONFIG and size >= SET_CONFIG_SIZE:
            key, value = struct.unpack_from(SET_CONFIG_FORMAT, raw, PAYLOAD)
            import set_config

            set_config.set_config(node, seq, key, value)
        elif request == REBOOT and size >= REBOOT_SIZE:
            self._reboot(seq, raw[PAYLOAD])
        elif request == _UPDATE_START:
            from radio import update

            update.start(node, frame)
        elif request in (TIME_REQUEST, BIAS_INIT, SET_CONFIG, REBOOT):
            self.nack(request, seq, REASON_BAD_VALUE, size)
        else:
            self.nack(request, seq, REASON_UNKNOWN_MESSAGE, request)

    def ack(self, request, seq):
        outbox = self._node.outbox
        struct.pack_into(ACK_FORMAT, outbox.note(), PAYLOAD, request, seq)
        outbox.post(ACK, ACK_SIZE)

    def nack(self, request, seq, reason, detail):
        outbox = self._node.outbox
        struct.pack_into(NACK_FORMAT, outbox.note(), PAYLOAD, request, seq, reason, detail)
        outbox.post(NACK, NACK_SIZE)

    def bias_done(self, refused):
        """Answer the pending BiasInit: the initialisation has ended, or was refused for a Reason."""
        seq, self._bias_seq = self._bias_seq, -1
        if seq < 0:
            return
        if refused:
            self.nack(BIAS_INIT, seq, refused, 0)
        else:
            self.ack(BIAS_INIT, seq)

    def bias_given_up(self):
        """Answer a pending BiasInit with NO_IMU, as sampling has stopped."""
        seq, self._bias_seq = self._bias_seq, -1
        if seq >= 0:
            self.nack(BIAS_INIT, seq, REASON_NO_IMU, self._node.parts.faults)

    def _reply_time(self, raw, received_us):
        outbox = self._node.outbox
        note = outbox.note()
        for i in range(PAYLOAD, PAYLOAD + 8):
            note[i] = raw[i]
        struct.pack_into("<II", note, PAYLOAD + 8, received_us, ticks_us())
        outbox.post(TIME_REPLY, TIME_REPLY_SIZE)

    def _start_bias(self, seq, samples):
        node = self._node
        if samples < MIN_SAMPLES:
            self.nack(BIAS_INIT, seq, REASON_BAD_VALUE, samples)
        elif node.parts.chip is None:
            self.nack(BIAS_INIT, seq, REASON_NO_IMU, node.parts.faults)
        elif node.init.state == FILTER_STATE_INITIALISING:
            self.nack(BIAS_INIT, seq, REASON_BUSY, 0)
        else:
            self._bias_seq = seq
            chip = node.parts.chip
            node.new_init()
            node.init.start(samples, chip.gyro_lsb_ndps, chip.accel_lsb_ng)

    def _reboot(self, seq, mode):
        if mode > REBOOT_MODE_REPL:
            self.nack(REBOOT, seq, REASON_BAD_VALUE, mode)
            return
        self.ack(REBOOT, seq)
        self._node.leave = mode
