"""Slow sampling at standstill: starts after the configured time, ends within two samples of a motion."""

from types import SimpleNamespace

import numpy as np
import pytest
from outbox import FIRST_ROW
from slow_sampling import SlowSampling

from fakes.fake_port import PORT_TICKS
from hubodo.emulator.board.settings import BoardSettings, SensorBoard
from hubodo.emulator.motion import RecordedMotion
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.outputs import HelloReceived
from hubodo.log.records import ImuBlock
from hubodo.recording import Event
from hubowire import messages as m
from virtual_runs import messages_of, run

CONFIG = {"rest_after_s": 3, "rest_rate_hz": 26, "rate_hz": 416, "mag_rate_hz": 0}
# This interpreter does not collect garbage while running, and a change of the rate creates some.
BOARD = BoardSettings(heap_bytes=512 * 1024)
MOVES_AT = 8.013
SLOW_S = 1 / 26


def motion_after(moves_at, seconds, kind):
    """Return a standstill until `moves_at`, then rolling at 2 rad/s or one knock between two slow samples."""
    t = np.arange(0, seconds + 1, 0.001)
    gyro, accel = np.zeros((len(t), 3)), np.tile([9.8, 0.1, 0.2], (len(t), 1))
    after = t > moves_at
    if kind == "rolls":
        gyro[after, 2] = 2.0
        angle = np.where(after, 2.0 * (t - moves_at), 0.0)
        accel[:, 0], accel[:, 1] = 9.8 * np.cos(angle), -9.8 * np.sin(angle)
    elif kind == "knock":
        accel[(t > moves_at) & (t < moves_at + SLOW_S), 2] += 12.0
    return RecordedMotion(t, gyro, accel, temperature_c=25.0, start=0.0)


def decode_on_host(sent):
    """Decode the frames as a host does; return the records and the decoder."""
    decoder = NodeDecoder("left")
    out = []
    for k, (frame, _) in enumerate(sent):
        out += decoder.decode_frame(frame, k * 20_000_000, LinkCounts())
    return [*out, *decoder.close()], decoder


@pytest.mark.parametrize("how", ["rolls", "knock"])
def test_a_static_node_samples_slowly_and_resumes_within_two_samples_without_loss(how):
    sent, truth, stats = run(11, motion=motion_after(MOVES_AT, 11, how), config=CONFIG, board=BOARD)
    assert stats["resets"] == [] and not stats["counts"].get("at_prompt")
    steps = np.diff(truth.t)
    slow = np.flatnonzero(steps > 0.03)
    began, ended = truth.t[slow[0]], truth.t[slow[-1] + 1]
    assert 3.0 < began < 3.7
    assert MOVES_AT < ended < MOVES_AT + 2 * SLOW_S + 0.01
    assert np.allclose(steps[slow[1:-1]], SLOW_S, rtol=0.05)
    assert np.median(steps[truth.t[:-1] > ended + 0.1]) == pytest.approx(1 / 416, rel=0.01)
    hellos = [h.rate_mhz for h in messages_of(sent, m.Hello)]
    assert sorted(set(hellos)) == [26000, 416000]
    items, decoder = decode_on_host(sent)
    assert decoder.counts.samples_lost == decoder.counts.gaps == 0
    assert not [e for e in items if isinstance(e, Event) and e.kind == "gap"]
    rates = [round(e.data["rate_hz"]) for e in items if isinstance(e, Event) and e.kind == "rate"]
    assert rates[0] == pytest.approx(26, abs=1) and rates[1] == pytest.approx(416, abs=6)
    assert len([h for h in items if isinstance(h, HelloReceived)]) >= 2
    t = np.concatenate([b.device_ns for b in items if isinstance(b, ImuBlock)]) * 1e-9
    assert np.all(np.diff(t) > 0) and np.diff(t).max() < 0.2


def test_uniform_rolling_is_not_a_standstill_and_without_the_setting_the_rate_is_constant():
    _, truth, _ = run(7, motion=motion_after(0.0, 7, "rolls"), config=CONFIG, board=BOARD)
    assert np.diff(truth.t).max() < 0.03
    _, truth, _ = run(
        6, motion=motion_after(99.0, 6, "rolls"), config={**CONFIG, "rest_after_s": 0}, board=BOARD
    )
    assert np.diff(truth.t).max() < 0.03


def test_slow_sampling_works_on_an_mpu_without_motion_flag():
    config = {**CONFIG, "rate_hz": 200, "rest_rate_hz": 50}
    sent, truth, _ = run(
        11,
        motion=motion_after(MOVES_AT, 11, "rolls"),
        config=config,
        board=BOARD,
        sensors=SensorBoard(chip="mpu6050"),
    )
    steps = np.diff(truth.t)
    slow = np.flatnonzero(steps > 0.015)
    assert 3.0 < truth.t[slow[0]] < 3.7
    assert MOVES_AT < truth.t[slow[-1] + 1] < MOVES_AT + 3 / 50 + 0.01
    _, decoder = decode_on_host(sent)
    assert decoder.counts.samples_lost == 0


class ChipWithMotionFlag:
    """A chip with a given motion flag (None: read error); its steps are 0.07 deg/s and 0.488 mg."""

    gyro_lsb_ndps, accel_lsb_ng = 70_000_000, 488_000
    MOTION_FLAG = (0x1B, 0x08)

    def __init__(self, answer=0):
        self.answer = answer

    def read(self, register):
        assert register == 0x1B
        if self.answer is None:
            raise OSError(5)
        return self.answer


STILL = [10, -20, 30, 100, -200, 2000]


def create_slow_sampling(after_s=3, chip=None):
    """Return slow sampling that starts at 0 ms with a static sample, and the list of its rate changes."""
    PORT_TICKS.now_us = 0
    settings = {"rest_after_s": after_s, "rest_dps": 2, "rest_mg": 20}
    parts = SimpleNamespace(chip=chip or ChipWithMotionFlag(), paused=False)
    sampler = SimpleNamespace(count=0, slot=SimpleNamespace(values=[0] * FIRST_ROW + STILL * 4))
    sampling, changes = SlowSampling(SimpleNamespace(parts=parts, settings=settings, sampler=sampler)), []

    def change(_chip, to_rest):
        changes.append(to_rest)
        sampling.is_slow, sampling._in_motion = to_rest, False

    sampling._change = change
    sampling.use(STILL, 0, 1)
    sampling.step(0)
    return sampling, changes


@pytest.mark.parametrize("after_s", [1, 3, 5000])
def test_sampling_slows_down_after_the_configured_standstill(after_s):
    sampling, changes = create_slow_sampling(after_s)
    for ms in range(20, 1000 * after_s, 980):
        sampling.use(STILL * 4, 0, 4)
        sampling.step(ms)
        assert not changes
    sampling.step(1000 * after_s - 1)
    assert not changes
    sampling.step(1000 * after_s)
    assert changes == [True]


@pytest.mark.parametrize(
    ("column", "change", "moves"),
    [
        (0, 28, False),
        (2, 29, True),
        (1, -28, False),
        (1, -29, True),
        (3, 40, False),
        (5, -41, True),
        (4, 41, True),
    ],
)
def test_a_change_of_more_than_2_deg_per_s_or_20_mg_is_motion(column, change, moves):
    sampling, changes = create_slow_sampling()
    other = list(STILL)
    other[column] += change
    sampling.step(2000)
    sampling.use(other * 4, 0, 4)
    sampling.step(2500)
    sampling.step(3000)
    assert changes == ([] if moves else [True])
    sampling.step(5499)
    assert changes == ([] if moves else [True])
    if moves:
        # The new values are the reference of the next standstill.
        sampling.use(other * 4, 0, 4)
        sampling.step(5500)
        assert changes == [True]


def test_middle_and_end_of_a_batch_are_compared_and_when_slow_each_sample_once():
    jolt = [value + 500 for value in STILL]
    for index, differs in ((0, False), (1, False), (2, True), (3, True)):
        sampling, _ = create_slow_sampling()
        sampling.use([0, 0, *STILL * index, *jolt, *STILL * (3 - index)], 2, 4)
        assert sampling._in_motion == differs
    sampling, changes = create_slow_sampling()
    sampling.step(3000)
    compared = []

    def compare(_values, at):
        assert len(compared) < 9
        compared.append(at)

    sampling._compare = compare
    sampling._node.sampler.count = 2
    sampling.step(3020)
    sampling.step(3040)
    assert compared == [FIRST_ROW, FIRST_ROW + 6]
    sampling.use([0] * 40, 4, 4)
    assert compared[2:] == [4 + 12, 4 + 18], "the samples since the last comparison"
    sampling.use([0] * 40, 4, 1)
    assert compared[4:] == [4]
    assert changes == [True]


@pytest.mark.parametrize(
    ("flag", "answer", "wakes"),
    [
        ((0x1B, 0x08), 0x08, True),
        ((0x1B, 0x08), 0x77, False),
        ((0x1B, 0x08), None, False),
        ((), 0x08, False),
    ],
)
def test_the_motion_flag_of_the_chip_ends_slow_sampling(flag, answer, wakes):
    chip = ChipWithMotionFlag()
    sampling, changes = create_slow_sampling(chip=chip)
    sampling.step(3000)
    chip.MOTION_FLAG, chip.answer = flag, answer
    sampling.step(3020)
    assert changes == ([True, False] if wakes else [True])


def test_without_a_chip_or_on_a_paused_bus_the_rate_is_unchanged():
    for state in ({"chip": None}, {"paused": True}):
        sampling, changes = create_slow_sampling()
        vars(sampling._node.parts).update(state)
        sampling.step(3000)
        assert not changes
