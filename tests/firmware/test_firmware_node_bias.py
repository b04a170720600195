"""The whole node estimates its gyro's bias in each possible way, and reports it beside raw samples."""

from types import SimpleNamespace

import bias_choice
import numpy as np
import pytest
from node import Node

from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.emulator.motion import RecordedMotion, StillMotion
from hubodo.flash.node_settings import apply_calibration_to_config
from hubowire import messages as m
from virtual_runs import match_samples, messages_of, request, run


def test_the_bias_of_a_static_wheel_is_estimated_and_of_a_turning_one_refused():
    rate = (0.02, -0.05, 0.1)
    init = [(0.5, request(7, m.BiasInit(2000)))]
    sent, _, _ = run(12, motion=StillMotion(rate=rate), script=init, config={"rate_hz": 416})
    assert [a.request_seq for a in messages_of(sent, m.Ack)] == [7]
    last = messages_of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.samples == 2000
    steps = np.round(np.degrees(rate) / 0.07)
    np.testing.assert_allclose(np.array(last.bias_q12) / 4096, steps, atol=0.01)
    np.testing.assert_allclose(np.array(last.rate_q8) / 256, 0, atol=0.05)

    sent, _, _ = run(12, motion=StillMotion(rate=(0, 0, 2.0)), script=init, config={"rate_hz": 416})
    assert [(n.request_seq, n.reason) for n in messages_of(sent, m.Nack)] == [(7, m.Reason.WHEEL_TURNS)]
    assert messages_of(sent, m.Filter)[-1].state == m.FilterState.WAITING


@pytest.mark.parametrize(("forgetting", "deviation"), [(1_027_604, 0.1), (964_690, 0.2)])
def test_recursive_least_squares_is_selected_by_configuration(forgetting, deviation):
    """Forgetting factors 0.98 and 0.92 are set while running; the node reports the rate without the bias."""
    script = [
        (0.3, request(1, m.SetConfig(m.ConfigKey.FORGETTING_Q20, forgetting))),
        (0.4, request(2, m.SetConfig(m.ConfigKey.FILTER_KIND, m.FilterKind.RLS))),
        (0.5, request(3, m.BiasInit(2000))),
        (0.6, request(4, m.GetHello())),
    ]
    motion = StillMotion(rate=(0.02, -0.05, 0.1))
    sent, _, _ = run(7, motion=motion, script=script, config={"rate_hz": 416})
    assert {ack.request_seq for ack in messages_of(sent, m.Ack)} == {1, 2, 3}
    assert messages_of(sent, m.Hello)[-1].filter_kind == m.FilterKind.RLS
    last = messages_of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.saturations == 0
    np.testing.assert_allclose(np.array(last.rate_q8) / 256, 0, atol=deviation)


def test_configured_bias_and_warm_up_are_reported_beside_raw_samples():
    """Bias and warm-up come from /config.json without initialisation; samples are sent uncorrected."""
    config = {
        "bias_udps": [210_000, 0, -140_000],
        "warmup_udps": [700_000, -1_400_000, 0],
        "warmup_s": 10,
        "warmup_second": [0, 700_000, 350_000, 40],
    }
    sent, truth, _ = run(12, config=config)
    matches = match_samples(sent, truth)
    assert np.array_equal(matches[:, 0], np.arange(len(matches))), "samples are sent unchanged"
    reports = [f for f in messages_of(sent, m.Filter) if f.state == m.FilterState.TRACKING]
    assert {f.samples for f in reports} == {0} and {f.bias_sigma_q12 for f in reports} == {(0, 0, 0)}
    age = np.array([f.t_us for f in reports]) * 1e-6
    bias = np.array([f.bias_q12 for f in reports]) / 4096
    first_term = -np.expm1(-age / 10)[:, None]
    second_term = -np.expm1(-age / 40)[:, None]
    expected = np.array([3.0, 0.0, -2.0]) + first_term * np.array([10.0, -20.0, 0.0])
    expected = expected + second_term * np.array([0.0, 10.0, 5.0])
    # The Kalman filter changes the bias by k2 / k1 = 1e-6 of a rate of up to 7000 steps; a batch lasts 40 ms.
    np.testing.assert_allclose(bias, expected, atol=0.15)


def test_a_calibration_of_the_node_is_applied_once_by_the_host():
    """A static gyro warms up: the node sends raw samples and reports the bias, which the host removes."""
    c1, constant, bias = np.array([0.02, 0.0, -0.01]), 10.0, np.array([0.004, -np.radians(0.14), 0.0])
    t = np.arange(0, 14, 0.005)
    gyro = bias - c1 * np.expm1(-t / constant)[:, None]
    gyro[:, 0] += 0.01 * np.expm1(-t / 30.0)
    accel = np.tile([0.0, 0.0, 9.80665], (len(t), 1))
    effects = {
        "gyro_bias": dict(zip("xyz", bias, strict=True)),
        "gyro_warmup": {
            **dict(zip("xyz", c1, strict=True)),
            "time_constant": constant,
            "x_second": -0.01,
            "time_constant_second": 30.0,
        },
    }
    calibration = NodeCalibration(
        {
            name: CalibratedEffect({key: Quantity(float(value), 0.0) for key, value in values.items()})
            for name, values in effects.items()
        }
    )
    sent, _, _ = run(
        13,
        motion=RecordedMotion(t, gyro, accel, temperature_c=25.0, start=0.0),
        config=apply_calibration_to_config({"gain_bias_q30": 0}, calibration),
    )
    batches = messages_of(sent, m.ImuBatch)[10:]
    age = np.concatenate([b.t_us + b.period_ns / 1000 * np.arange(len(b.samples)) for b in batches]) * 1e-6
    raw = np.concatenate([b.samples for b in batches])
    measured = raw[:, :3] * np.radians(0.07)
    corrected, _ = SampleCorrection.from_calibration(calibration).apply(measured, raw[:, 3:] * 1.0, age=age)
    assert np.abs(measured[-100:].mean(axis=0) - gyro[-200]).max() < 1e-3, "samples are sent uncorrected"
    # A step is 1.2e-3 rad/s and the bias changes by ten steps: only the rounding error remains.
    assert np.abs(corrected).max() < 0.52 * np.radians(0.07) and np.abs(corrected.mean(axis=0)).max() < 1e-4
    reports = [f for f in messages_of(sent, m.Filter) if f.state == m.FilterState.TRACKING][5:]
    ages = np.array([f.t_us for f in reports]) * 1e-6
    exact = bias - c1 * np.expm1(-ages / constant)[:, None]
    exact[:, 0] += 0.01 * np.expm1(-ages / 30.0)
    reported_bias = np.array([f.bias_q12 for f in reports]) / 4096 * np.radians(0.07)
    assert np.abs(reported_bias - exact).max() < 0.1 * np.radians(0.07)


def test_the_bias_is_estimated_while_the_wheel_turns():
    """Gravity rotates at 4 rad/s with a bias of 1 deg/s along the axle; a stationary wheel is refused."""
    t = np.arange(0, 31, 0.001)
    accel = np.stack([9.80665 * np.cos(4 * t), -9.80665 * np.sin(4 * t), 0 * t], axis=1)
    gyro = np.tile([0.0, 0.0, 4.0 + np.radians(1.0)], (len(t), 1))
    config = {"bias_kind": m.BiasKind.GRAVITY, "bias_sigma_udps": 2_000_000, "phase_mrad": 5}
    config["gyro_scale_sigma_ppm"] = 0
    init = [(1.0, request(7, m.BiasInit(5000)))]
    sent, _, _ = run(
        27, motion=RecordedMotion(t, gyro, accel, temperature_c=25.0), config=config, script=init
    )
    assert [a.request_seq for a in messages_of(sent, m.Ack)] == [7]
    last = messages_of(sent, m.Filter)[-1]
    assert last.state == m.FilterState.TRACKING and last.samples == 5000
    sigma = np.array(last.bias_sigma_q12) / 4096
    assert last.bias_q12[2] / 4096 == pytest.approx(1 / 0.07, abs=4 * sigma[2]) and sigma[2] < 1
    assert sigma[0] > 25, "the bias across the axle is not observable"

    sent, _, _ = run(27, motion=StillMotion(), config=config, script=init)
    assert [(n.request_seq, n.reason) for n in messages_of(sent, m.Nack)] == [(7, m.Reason.WHEEL_RESTS)]


@pytest.mark.parametrize("kind", [m.BiasKind.REST, m.BiasKind.TABLE])
def test_the_kind_of_initialisation_can_be_set_while_running(kind):
    """The node stands still, or rotates on a table at 45 deg/s, a rate that is configured too."""
    bias_rate = np.array([0.02, -0.05, 0.1])
    rate = bias_rate + (np.array([0.0, 0.0, np.radians(45.0)]) if kind == m.BiasKind.TABLE else 0.0)
    script = [
        (0.3, request(1, m.SetConfig(m.ConfigKey.BIAS_KIND, kind))),
        (0.4, request(2, m.SetConfig(m.ConfigKey.TABLE_RATE_UDPS, 45_000_000))),
        (0.5, request(3, m.BiasInit(2000))),
    ]
    sent, _, _ = run(7, motion=StillMotion(rate=rate), script=script, config={"rate_hz": 416})
    assert {ack.request_seq for ack in messages_of(sent, m.Ack)} == {1, 2, 3}
    last = messages_of(sent, m.Filter)[-1]
    steps, sigma = np.degrees(bias_rate) / 0.07, np.array(last.bias_sigma_q12) / 4096
    reported_bias = np.array(last.bias_q12) / 4096
    print(f"{kind.name}: {reported_bias} of {steps} steps, sigma {sigma}")
    assert last.state == m.FilterState.TRACKING and last.samples == 2000
    if kind == m.BiasKind.REST:
        np.testing.assert_allclose(reported_bias, steps, atol=0.6)
    else:
        assert abs(reported_bias[2] - steps[2]) < 3 * sigma[2] and sigma[2] < sigma[0] / 4


class FakeCommands:
    """Records all method calls in order."""

    def __init__(self, **answers):
        self.answers, self.calls = answers, []

    def __getattr__(self, name):
        def call(*arguments):
            self.calls.append((name, *arguments))
            answer = self.answers.get(name)
            return answer(*arguments) if callable(answer) else answer

        return call


def node_in_state(state, ended=False, estimator=True):
    fake = object.__new__(Node)
    fake.sampler = SimpleNamespace(first_index=100)
    fake.init = FakeCommands(update=ended, now_q14=lambda axis: 10 + axis)
    fake.init.state, fake.init.refused = state, 7
    fake.estimator = FakeCommands() if estimator else None
    fake.commands, fake.slow = FakeCommands(), None
    fake._next_index = 100
    return fake


@pytest.mark.parametrize("estimator", [True, False])
@pytest.mark.parametrize("state", list(m.FilterState))
def test_samples_go_to_the_initialisation_or_once_tracking_to_the_filter(state, estimator):
    node = node_in_state(state, estimator=estimator)
    node._batch_done("samples", 6, 8)
    updates = [("update", "samples", 6, 8)]
    assert node.init.calls == (updates if state == m.FilterState.INITIALISING else [])
    if estimator:
        assert node.estimator.calls == (updates if state == m.FilterState.TRACKING else [])
    assert node.commands.calls == [] and node._next_index == 108


def test_after_the_initialisation_the_filter_starts_with_its_bias_and_the_host_gets_an_answer():
    node = node_in_state(m.FilterState.INITIALISING, ended=True)
    node.slow = FakeCommands()
    node._batch_done("samples", 0, 4)
    assert node.estimator.calls == [("reset", axis, 10 + axis) for axis in range(3)]
    assert node.commands.calls == [("bias_done", 7)]
    assert node.slow.calls == [("use", "samples", 0, 4)]
    node.sampler.first_index = 105
    node._batch_done("samples", 0, 4)
    assert ("gap",) in node.init.calls


def test_a_warm_up_changes_the_bias_of_initialisation_and_filter():
    node = node_in_state(m.FilterState.TRACKING)
    node.drift(SimpleNamespace(step_q18=[1, -2, 3]))
    drifts = [("drift", 0, 1), ("drift", 1, -2), ("drift", 2, 3)]
    assert node.init.calls == node.estimator.calls == drifts


def test_the_configured_bias_is_set_once_per_step_size_including_the_warm_up_so_far(
    monkeypatch,
):
    node = node_in_state(m.FilterState.WAITING)
    node._lsb_ndps, node.settings, node.parts = 0, {}, SimpleNamespace(was_running=False)
    node.parts.chip = SimpleNamespace(gyro_lsb_ndps=70_000_000)
    warm = [SimpleNamespace(drift_q18=lambda axis: 160), SimpleNamespace(drift_q18=lambda axis: 16 * axis)]
    monkeypatch.setattr(bias_choice, "warm_up", lambda *_: warm)
    monkeypatch.setattr(bias_choice, "known_bias_q18", lambda s, axis, chip: 1600 if axis else None)
    for _ in range(2):
        node._set_bias()
    given = [call for call in node.init.calls if call[0] == "give"]
    assert given == [("give", axis, 100 + 10 + axis) for axis in (1, 2)]
    assert len(node.estimator.calls) == 3 and node.warm == warm
    node.parts.chip = SimpleNamespace(gyro_lsb_ndps=35_000_000)
    node._set_bias()
    assert len([call for call in node.init.calls if call[0] == "give"]) == 4
