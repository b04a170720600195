"""Rides of nodes that send to a receiver by radio, as virtual boards on one radio medium."""

from dataclasses import dataclass

import numpy as np

import hubowire
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m
from virtual_runs import FIRMWARE, count_missing_frames, match_samples, messages_of, unique_motion

RECEIVER = 200
SECONDS = 3.2


@dataclass
class RadioRun:
    """Frames that the receiver's host got from each node and from the receiver, and each chip's samples."""

    sent: dict
    truths: dict
    of_receiver: list
    air: dict
    dropped: dict

    def signal(self, node_id):
        return [s for s in messages_of(self.of_receiver, m.Signal) if s.of_node == node_id][-1]


def ride(
    weather,
    *,
    link="nrf24",
    ids=(1, 2),
    tries=15,
    faults=(),
    host_pauses=(),
    script=(),
    seconds=SECONDS,
    cut=0,
    interpreter="cpython",
    seed=7,
    rate_hz=208,
    over_uart=False,
):
    """Run all boards on one radio medium in virtual time; over_uart: receiver to host, not by its console."""
    radio_medium = RadioMedium(weather, seed=seed)

    def board(config, motion, *, chip=0.0, uart_link=None, **settings):
        settings = {"host": Host("memory"), **settings}
        return VirtualNode(
            motion,
            Flash(FIRMWARE, config),
            sensors=SensorBoard(specimen=Specimen(odr_error=chip)),
            board=BoardSettings(
                interpreter=interpreter,
                model="esp32" if link == "espnow" else "pico",
                uart_link=uart_link,
                unique_id=f"e66141{config['node_id']:02x}000000{config['node_id']:02x}",
            ),
            clock=Clock("stepped", run_for=seconds),
            own_process=False,
            radio_medium=radio_medium,
            **settings,
        )

    common = {"link": link, "rate_hz": rate_hz, "radio_tries": tries}
    nodes = {k: board({"node_id": k, **common}, unique_motion(seconds), chip=0.013 * (k - 1)) for k in ids}
    config = {"node_id": RECEIVER, "receiver": link, "radio_nodes": list(ids), "mag_rate_hz": 0}
    if over_uart:
        config["link"] = "uart"
    host = Host("memory", read_pauses=tuple(host_pauses), script=tuple(script))
    uart = {"espnow": 2, "nrf24": 0}[link] if over_uart else None
    receiver = board(config, StillMotion(), host=host, faults=tuple(faults), uart_link=uart)
    boards = [*nodes.values(), receiver]
    try:
        for one in boards:
            one.start()
        for one in boards:
            one.wait(100)
        decoder = hubowire.FrameDecoder()
        sent = [(f, hubowire.decode(f.type_id, f.payload)) for f in decoder.feed(receiver.output)]
        assert decoder.damage.frames == cut
        assert all(one.stats["resets"] == [] and not one.stats["counts"].get("at_prompt") for one in boards)
        return RadioRun(
            {k: [x for x in sent if x[0].node == k] for k in ids},
            {k: node.chip.truth() for k, node in nodes.items()},
            [x for x in sent if x[0].node == RECEIVER],
            dict(radio_medium.counts),
            {k: messages_of([x for x in sent if x[0].node == k], m.Health)[-1].frames_dropped for k in ids},
        )
    finally:
        for one in boards:
            one.stop()


def assert_nothing_lost(run):
    """Assert that every sample arrived except those in flight at the end, and that no loss was counted."""
    for k, sent in run.sent.items():
        matches = match_samples(sent, run.truths[k])
        assert np.all(np.diff(matches[:, 0]) == 1) and matches[0, 0] <= 8
        assert len(matches) >= len(run.truths[k].t) - 32, "only the last samples may be missing"
        assert count_missing_frames(sent) == 0 and run.dropped[k] == 0
        assert run.signal(k).frames_lost == 0
