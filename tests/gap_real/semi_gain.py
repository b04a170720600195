"""Gain by knowing an effect where the wheels' own gyros measure the speed, in nats.

An effect on a gyro along the axle then moves the predictions of all nodes. The noise is taken as white, with
the rms of the resampled one at each spin rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from gap_matrix import cases, effects, sensor
from gap_matrix.cases import Setup
from gap_matrix.dose import GainMeter
from gap_matrix.effects import SIDES, Effect
from gap_matrix.world import Array, Motion

SCATTER_EFFECTS = (
    "gyro_quantization", "gyro_rate_random_walk", "outliers", "sample_repeat",
    "gyro_saturation", "accel_saturation",
)  # fmt: skip


class NodesGainMeter(GainMeter):
    """A meter of gains with the speed from the nodes.

    sigma: (n, 6) of each node, the rms of its noise
    """

    def __init__(self, setup: Setup, sigma: Mapping[str, Array]) -> None:
        super().__init__(setup)
        for side, node in self._nodes.items():
            speed_noise = sigma[side][:, 2] / np.sqrt(2.0)
            period = float(np.mean(np.diff(setup.sample_times[side])))
            walk = speed_noise**2 * period * np.diff(setup.sample_times[side], prepend=0.0)
            self._nodes[side] = replace(node, sigma=sigma[side], angle_walk_variance=walk)
        self._true_speed = self._measure_speed(())

    def gain(self, effect: Effect) -> float:
        """Return the expected gain in nats, summed over both nodes."""
        if effect.name in SCATTER_EFFECTS:
            return super().gain(effect)
        differences = self.compute_differences(effect)
        return sum(self.gain_of_difference(side, differences[side]) for side in SIDES)

    def gain_in_noise(self, effect: Effect, draws: Sequence[Mapping[str, Array]]) -> float:
        """Return the gain in nats of an estimate with white weights in noise that is not white.

        draws: samples of the noise of each node, (n, 6)

        For a known difference d and weights W, the estimate of its size has the variance of d'Wn / (d'Wd)²
        over draws n of the noise; the gain is half of its squared ratio to sigma. An effect on scatter gains
        as in white noise.
        """
        if effect.name in SCATTER_EFFECTS:
            return super().gain(effect)
        differences = self.compute_differences(effect)
        white = sum(self.gain_of_difference(side, differences[side]) for side in SIDES)
        projections = [
            sum(
                0.5 * self.gain_of_difference(side, differences[side] + draw[side])
                - 0.5 * self.gain_of_difference(side, differences[side] - draw[side])
                for side in SIDES
            )
            for draw in draws
        ]
        return float(2.0 * white**2 / np.mean(np.square(projections)))

    def compute_differences(self, effect: Effect) -> dict[str, Array]:
        """Return the difference (n, 6) of each node's readings from those expected at the measured speed.

        A difference of the wheel angle enters linearly, however large: the angle is tracked.
        """
        motion = self.setup.drive.motion
        measured = self._measure_speed((effect,)) - self._true_speed
        expected_setup = replace(
            self.setup,
            drive=replace(self.setup.drive, motion=Motion(motion.speed + measured, motion.yaw_rate)),
        )
        return {side: self._compute_difference(side, effect, expected_setup) for side in SIDES}

    def _compute_difference(self, side: str, effect: Effect, expected_setup: Setup) -> Array:
        present = [effect] if effect.applies_to(side) else []
        t, step = self.setup.sample_times[side], self.setup.drive.motion.step
        stamps = sensor.compute_time_stamps(t, effects.parameters_on_node(present, side))
        stamps = np.clip(stamps, 0.0, self.setup.drive.duration)
        true = cases.compute_node_readings(self.setup, side, present)
        expected = cases.compute_node_readings(expected_setup, side, [])
        advance = (
            sensor.interpolate_cubic(true.angle[None], step, t)
            - sensor.interpolate_cubic(expected.angle[None], step, stamps)
        )[0]
        reading = self._compute_clean_readings(side, true, present, t)
        prediction = self._compute_clean_readings(side, expected, [], stamps)
        facing = 1.0 if self.setup.facing[side] == "left" else -1.0
        for x in (0, 3):
            turned = (prediction[:, x] + 1j * facing * prediction[:, x + 1]) * np.exp(-1j * advance)
            prediction[:, x], prediction[:, x + 1] = turned.real, facing * turned.imag
        return np.asarray(reading - prediction + self._nodes[side].angle_derivative * advance[:, None])

    def _measure_speed(self, hidden: Sequence[Effect]) -> Array:
        """Return the mean speed by the gyros along the axles, (N,) m/s at the times of the motion."""
        motion, total = self.setup.drive.motion, np.zeros(1)
        for side in SIDES:
            present = [effect for effect in hidden if effect.applies_to(side)]
            t = self.setup.sample_times[side]
            ideal = cases.compute_node_readings(self.setup, side, present)
            gz = self._compute_clean_readings(side, ideal, present, t)[:, 2]
            stamps = sensor.compute_time_stamps(t, effects.parameters_on_node(present, side))
            facing = 1.0 if self.setup.facing[side] == "left" else -1.0
            inside = np.clip(motion.t, stamps[0], stamps[-1])
            total = total + 0.5 * facing * self.setup.radius * CubicSpline(stamps, gz)(inside)
        return total
