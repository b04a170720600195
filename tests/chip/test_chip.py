"""The firmware on an emulated Pico processes every sample in time, without allocation."""

import numpy as np
import pytest
from chip_run import FIFO_SAMPLES, run_chip

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.chips.faults import BrownOut, BusNack, Stall, StuckBus
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image, firmware_folder
from hubodo.flash.slots import MAIN, SLOTS, main_for_slot
from hubowire import FrameDecoder, decode
from hubowire import messages as m
from repetitions import first_and_more
from virtual_runs import match_samples, messages_of, pico_or_skip, unique_motion

# name: (configuration, emulated seconds). `make chip` runs the other rates too, and for a minute.
RUNS = {
    "default, 416": ({}, 2.2),
    "1660": ({"rate_hz": 1660}, 2.2),
}
# Upper limits of a run.
LOST = 0
FIFO_SHARE = 0.5
ALLOCATIONS = 0.0
BEGIN_US = 500.0
LATER_US = 100.0
# Modules that are needed once are loaded and freed one by one, which takes 0.03 s and leaves 8 kB of heap.
HELLO_S = 0.75


def armv6m(folder):
    """Write the firmware into `folder`, compiled and laid out for a Pico as `hubodo flash` does."""
    slot = SLOTS[0]
    for name, content in build_image(firmware_folder(), "armv6m").items():
        place = folder / (name if name == MAIN else f"{slot[1:]}/{name}")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(main_for_slot(content, slot) if name == MAIN else content)
    return folder


@pytest.fixture(
    scope="module",
    params=first_and_more("1660", "default, 416"),
    ids=lambda name: name.replace(", ", "-").replace(" ", "-"),
)
def run(request, tmp_path_factory):
    pico_or_skip()
    config, seconds = RUNS[request.param]
    matches = run_chip(request.param, config, armv6m(tmp_path_factory.mktemp("firmware")), seconds)
    print(matches)
    return matches


def test_no_sample_is_lost(run):
    assert run.samples > 100
    assert run.lost <= LOST


def test_the_fifo_is_never_more_than_half_full(run):
    """Bursts that are late and loops that are too slow would fill the FIFO."""
    if run.fifo_share is None:
        pytest.skip("this configuration asks for each sample")
    assert run.fifo_share <= FIFO_SHARE
    assert run.waiting <= FIFO_SHARE * FIFO_SAMPLES


def test_the_loop_allocates_nothing(run):
    assert run.allocations <= ALLOCATIONS


def test_stamps_are_right_from_the_first_sample_on(run):
    assert max(map(abs, run.begin_us)) <= BEGIN_US
    assert max(map(abs, run.later_us)) <= LATER_US


def test_hello_is_sent_soon_after_power_on(run):
    assert run.hello_s <= HELLO_S


@pytest.mark.repeat  # test_node_faults has these faults, test_emulated_pico those of this board
def test_a_bus_that_fails_a_chip_that_restarts_and_a_busy_processor_are_got_over(tmp_path):
    """Every sample is the chip's own, in order, to the end; missing samples are announced."""
    pico_or_skip()
    faults = [BusNack(1.0, 3), StuckBus(1.3), BrownOut(1.6, affected="chips"), Stall(2.2, 0.05)]
    node = VirtualNode(
        unique_motion(3),
        Flash(armv6m(tmp_path), {"rate_hz": 416}),
        board=BoardSettings(interpreter="rp2040"),
        clock=Clock("stepped", run_for=2.6),
        host=Host("memory"),
        faults=faults,
    )
    with node:
        node.wait(120)
        output, truth, stats = node.output, node.chip.truth(), node.stats
    sent = [(frame, decode(frame.type_id, frame.payload)) for frame in FrameDecoder().feed(output)]
    matches = match_samples(sent, truth)
    assert truth.t[int(matches[-1, 0])] > 2.5
    missing = int((np.diff(matches[:, 0]) - 1).sum())
    announced = sum(bool(b.flags & m.BatchFlag.GAP_BEFORE) for b in messages_of(sent, m.ImuBatch))
    assert missing > 0 and announced >= 1
    assert stats["counts"]["stalls"] == 1 and stats["bus"]["freed"] == 1 and stats["resets"] == []
