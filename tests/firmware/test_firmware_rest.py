"""A node at rest: slow after its time, awake within two slow samples of a motion, no gap told for it."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import BoardSettings, SensorBoard
from hubodo.emulator.motion import RecordedMotion
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.samples import HelloSeen, ImuBlock
from hubodo.recording import Event
from hubowire import messages as m
from virtual_runs import of, run

REST = {"rest_after_s": 3, "rest_rate_hz": 26, "rate_hz": 416, "mag_rate_hz": 0}
# This interpreter collects no garbage while it runs, and a change of the rate makes some.
BOARD = BoardSettings(heap_bytes=512 * 1024)
MOVES_AT = 8.013
SLOW_S = 1 / 26


def rolls(moves_at, seconds, how):
    """At rest until then; it rolls at 2 rad/s, or gets one knock between two slow samples, or creeps."""
    t = np.arange(0, seconds + 1, 0.001)
    gyro, accel = np.zeros((len(t), 3)), np.tile([9.8, 0.1, 0.2], (len(t), 1))
    after = t > moves_at
    if how == "rolls":
        gyro[after, 2] = 2.0
        angle = np.where(after, 2.0 * (t - moves_at), 0.0)
        accel[:, 0], accel[:, 1] = 9.8 * np.cos(angle), -9.8 * np.sin(angle)
    elif how == "knock":
        accel[(t > moves_at) & (t < moves_at + SLOW_S), 2] += 12.0
    return RecordedMotion(t, gyro, accel, temperature_c=25.0, start=0.0)


def told(sent):
    """What a host makes of it."""
    decoder = NodeDecoder("left")
    out = []
    for k, (frame, _) in enumerate(sent):
        out += decoder.frame(frame, k * 20_000_000, LinkCounts())
    return [*out, *decoder.close()], decoder


@pytest.mark.parametrize("how", ["rolls", "knock"])
def test_a_node_that_rests_slows_down_and_wakes_within_two_samples_and_nothing_is_lost(how):
    sent, truth, stats = run(11, motion=rolls(MOVES_AT, 11, how), config=REST, board=BOARD)
    assert stats["resets"] == [] and not stats["counts"].get("at_prompt")
    steps = np.diff(truth.t)
    slow = np.flatnonzero(steps > 0.03)
    began, ended = truth.t[slow[0]], truth.t[slow[-1] + 1]
    assert 3.0 < began < 3.7
    assert MOVES_AT < ended < MOVES_AT + 2 * SLOW_S + 0.01
    assert np.allclose(steps[slow[1:-1]], SLOW_S, rtol=0.05)
    assert np.median(steps[truth.t[:-1] > ended + 0.1]) == pytest.approx(1 / 416, rel=0.01)
    hellos = [h.rate_mhz for h in of(sent, m.Hello)]
    assert sorted(set(hellos)) == [26000, 416000]
    items, decoder = told(sent)
    assert decoder.counts.samples_lost == decoder.counts.gaps == 0
    assert not [e for e in items if isinstance(e, Event) and e.kind == "gap"]
    rates = [round(e.data["rate_hz"]) for e in items if isinstance(e, Event) and e.kind == "rate"]
    assert rates[0] == pytest.approx(26, abs=1) and rates[1] == pytest.approx(416, abs=6)
    assert len([h for h in items if isinstance(h, HelloSeen)]) >= 2
    t = np.concatenate([b.device_ns for b in items if isinstance(b, ImuBlock)]) * 1e-9
    assert np.all(np.diff(t) > 0) and np.diff(t).max() < 0.2


def test_a_wheel_that_rolls_evenly_does_not_rest_and_nothing_does_without_the_setting():
    _, truth, _ = run(7, motion=rolls(0.0, 7, "rolls"), config=REST, board=BOARD)
    assert np.diff(truth.t).max() < 0.03
    _, truth, _ = run(6, motion=rolls(99.0, 6, "rolls"), config={**REST, "rest_after_s": 0}, board=BOARD)
    assert np.diff(truth.t).max() < 0.03


def test_the_rest_is_the_same_over_an_mpu_without_the_event():
    config = {**REST, "rate_hz": 200, "rest_rate_hz": 50}
    sent, truth, _ = run(
        11,
        motion=rolls(MOVES_AT, 11, "rolls"),
        config=config,
        board=BOARD,
        sensors=SensorBoard(chip="mpu6050"),
    )
    steps = np.diff(truth.t)
    slow = np.flatnonzero(steps > 0.015)
    assert 3.0 < truth.t[slow[0]] < 3.7
    assert MOVES_AT < truth.t[slow[-1] + 1] < MOVES_AT + 3 / 50 + 0.01
    _, decoder = told(sent)
    assert decoder.counts.samples_lost == 0
