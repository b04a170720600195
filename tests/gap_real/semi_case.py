"""Semi-real cases: drives of the independent simulator with the residuals of real drives as noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from residual_noise import REAL_FACING, DriveNoise, turn_over
from semi_gain import SCATTER_EFFECTS, NodesGainMeter

from gap_matrix import cases, effects, sensor
from gap_matrix.cases import Setup
from gap_matrix.dose import STRENGTHS
from gap_matrix.effects import SIDES, Effect
from gap_matrix.world import GRAVITY, Array, differentiate, integrate
from hubodo.recording import Recording, Table
from vehicles import model_toml

ROAD_BANK = "road_bank"
EFFECT_NAMES = (*effects.KINDS, ROAD_BANK)
# Bank of real roads, rad, and its correlation length, m; scaled by the accelerometer noise of the car, m/s².
_BANK_SIGMA, _BANK_LENGTH_M, _CAR_ACCEL_NOISE = {"medium": 0.012, "strong": 0.036}, 80.0, 1.2
_MIN_VISIBLE_NATS = 0.5 * 3.0**2
_SPARE_SEEDS, _SPARE_SEED_STEP = 5, 100_000
# Draws of the noise that give its effect on an estimate within a fifth, and the step of their seeds.
_N_DRAWS, _DRAW_SEED_STEP = 12, 1_000_000
# Share of the typical size of an effect in the field at which it is injected.
_TYPICAL_SHARES = {"medium": 0.3, "strong": 1.0}
# Share of an effect of which the square hardly shows.
_LINEAR_SHARE = 0.01
_CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")


class Sizing(Enum):
    """The unit in which the strength of an injected effect is given.

    WHITE_NOISE: nats in white noise with the rms of the real one
    REAL_NOISE: nats in the real noise
    TYPICAL_SIZE: a share of its typical size in the field, and at least the nats in the real noise
    """

    WHITE_NOISE = "white"
    REAL_NOISE = "real"
    TYPICAL_SIZE = "typical"


@dataclass(frozen=True)
class SemiCase:
    """A simulated drive in the noise of a real drive, with or without an effect.

    gain_nats: gain by knowing the effect in white noise; nan for a road's bank and without an effect
    real_nats: gain in the real noise, of an estimate with white weights
    visible: parameters that the drive shows, which a result must contain
    """

    setup: Setup
    noise: DriveNoise
    effect: Effect | None
    gain_nats: float = np.nan
    real_nats: float = np.nan
    visible: tuple[str, ...] = ()

    @property
    def expected_effect(self) -> Effect | None:
        """Return the effect that a result is compared with.

        That of a bank has the rms of this drive, which is often shorter than a few correlation lengths.
        """
        if self.effect is None or self.effect.name != ROAD_BANK:
            return self.effect
        sigma = float(np.sqrt(np.mean(draw_bank(self.setup, self.effect) ** 2)))
        return replace(self.effect, parameters={**self.effect.parameters, "sigma": sigma})

    def write_model(self) -> str:
        """Return the text of the model file: nominal vehicle and declared noise."""
        noise = self.setup.noise["left"]
        return model_toml(
            self.setup.radius,
            self.setup.track,
            gyro_noise=noise.gyro,
            accel_noise=noise.accel,
            inputs='speed = "nodes"\nyaw_rate = "frame.gz"\n',
            facing=self.setup.facing,
        )

    def record(self) -> Recording:
        """Return the recording: both wheel nodes, and a node on the body that measures the yaw rate."""
        bank = draw_bank(self.setup, self.effect)
        nodes = {side: self._record_wheel(side, bank) for side in SIDES}
        return Recording({**nodes, "frame": self._record_body(bank)})

    def _record_wheel(self, side: str, bank: Array) -> Table:
        setup = self.setup
        hidden = [one for one in [self.effect] if one and one.name != ROAD_BANK and one.applies_to(side)]
        t, step = setup.sample_times[side], setup.drive.motion.step
        facing = 1.0 if setup.facing[side] == "left" else -1.0
        added = np.zeros((len(t), 6))
        added[:, 5] = facing * GRAVITY * sensor.interpolate_cubic(bank[None], step, t)[0]
        record = sensor.simulate_record(
            cases.compute_node_readings(setup, side, hidden),
            effects.parameters_on_node(hidden, side),
            t,
            setup.drive.temperature,
            setup.noise[side],
            np.random.default_rng((setup.seed, 3, SIDES.index(side))),
            added,
            draw_wheel_noise(setup, self.noise, side),
        )
        columns = dict(zip(_CHANNELS, record.values.T, strict=True))
        return Table({"t": record.t, **columns, "temperature": record.temperature})

    def _record_body(self, bank: Array) -> Table:
        """Return a node on the body origin, x forward, y left, z up."""
        setup, motion = self.setup, self.setup.drive.motion
        grade = self.effect.parameters["angle"] if self.effect and self.effect.name == "road_grade" else 0.0
        zero = np.zeros_like(motion.speed)
        force = (
            differentiate(motion.speed, motion.step) + GRAVITY * np.sin(grade),
            motion.speed * motion.yaw_rate + GRAVITY * bank,
            zero + GRAVITY * np.cos(grade),
        )
        stride = round(cases.REFERENCE_STEP / motion.step)
        readings = np.stack([zero, zero, motion.yaw_rate, *force], axis=1)[::stride]
        spin = np.abs(motion.speed[::stride]) / setup.radius
        rng = np.random.default_rng((setup.seed, 12))
        noise = self.noise.body.resample(spin, 1.0 / cases.REFERENCE_STEP, rng)
        readings = readings + noise * _declared_sigma(setup)
        return Table({"t": motion.t[::stride], **dict(zip(_CHANNELS, readings.T, strict=True))})


def draw_case(
    noise: DriveNoise,
    name: str,
    strength: str,
    seed: int,
    size: float = 1.0,
    duration: float | None = None,
    sizing: Sizing = Sizing.WHITE_NOISE,
) -> SemiCase:
    """Return a case; the first seed is used whose drive shows the effect.

    name: one of EFFECT_NAMES, or empty
    size: factor on the parameters of the effect beside its strength
    sizing: unit of the strength

    Raises ValueError if the drive of no seed shows the effect.
    """
    reason = ""
    for spare in range(_SPARE_SEEDS):
        setup = cases.draw_setup(seed + spare * _SPARE_SEED_STEP, duration=duration)
        if not name:
            return SemiCase(setup, noise, None)
        if name == ROAD_BANK:
            sigma = size * _BANK_SIGMA[strength] * setup.noise["left"].accel / _CAR_ACCEL_NOISE
            effect = Effect(name, "vehicle", {"sigma": sigma, "length": _BANK_LENGTH_M})
            return SemiCase(setup, noise, effect, visible=("sigma",))
        meter = NodesGainMeter(setup, {side: wheel_sigma(setup, noise, side) for side in SIDES})
        try:
            drawn = cases.draw_hidden_effect(setup, name)
            effect, _ = meter.scale_to_gain(drawn, STRENGTHS[strength])
        except ValueError as error:
            reason = str(error)
            continue
        effect = effects.scale_effect(effect, size)
        typical = size * _TYPICAL_SHARES[strength] if sizing is Sizing.TYPICAL_SIZE else 0.0
        draws = _draw_noise(setup, noise)
        if effect.name in SCATTER_EFFECTS:
            effect = _enlarge_to(effect, drawn, typical)
            effect = restrict_to_visible_side(meter, effect)
        elif sizing is not Sizing.WHITE_NOISE:
            target = size**2 * STRENGTHS[strength]
            factor = float(np.sqrt(target / meter.gain_in_noise(effect, draws)))
            effect = _enlarge_to(effects.scale_effect(effect, factor), drawn, typical)
            if not effects.is_possible(effect):
                reason = f"{name}: no possible size has {target:g} nats in the real noise"
                continue
        white, real = meter.gain(effect), meter.gain_in_noise(effect, draws)
        visible = list_visible_parameters(meter, effect, _MIN_VISIBLE_NATS * max(white / real, 1.0))
        return SemiCase(setup, noise, effect, white, real, visible)
    raise ValueError(reason)


def _enlarge_to(effect: Effect, typical: Effect, size: float) -> Effect:
    """Return an effect, or the typical one in a larger size."""
    return effect if effect.size >= size else effects.scale_effect(typical, size)


def restrict_to_visible_side(meter: NodesGainMeter, effect: Effect) -> Effect:
    """Return an effect of the samples of both nodes as that of the only node which shows it, if one does not.

    A limit that only one wheel reaches leaves the readings of the other as they are.
    """
    if effect.scope != "all" or effect.name not in SCATTER_EFFECTS:
        return effect
    alone = [replace(effect, scope=side) for side in SIDES]
    shown = [one for one in alone if meter.gain(one) > _MIN_VISIBLE_NATS]
    return shown[0] if len(shown) == 1 else effect


def list_visible_parameters(
    meter: NodesGainMeter, effect: Effect, min_gain: float = _MIN_VISIBLE_NATS
) -> tuple[str, ...]:
    """Return the parameters, except one of shape, that an oracle would see at 3 sigma without the others.

    min_gain: gain of 3 sigma in nats in white noise
    """
    names = [name for name in effect.parameters if name != effects.KINDS[effect.name].shape_parameter]
    if len(names) == 1:
        return tuple(names)
    others = {name: dict.fromkeys(set(names) - {name}, 0.0) for name in names}
    alone = {name: replace(effect, parameters={**effect.parameters, **others[name]}) for name in names}
    # A large rotation about the axle shows in the square of its angle, of which an estimate knows nothing.
    small = {name: effects.scale_effect(one, _LINEAR_SHARE) for name, one in alone.items()}
    return tuple(name for name in names if meter.gain(small[name]) > min_gain * _LINEAR_SHARE**2)


def _declared_sigma(setup: Setup) -> Array:
    noise = setup.noise["left"]
    return np.repeat([noise.gyro, noise.accel], 3)


def wheel_spin(setup: Setup, side: str) -> Array:
    """Return the nominal spin rate, (n,) rad/s, of a wheel at the samples of its node."""
    motion, sign = setup.drive.motion, 1.0 if side == "left" else -1.0
    spin = (motion.speed - 0.5 * sign * setup.track * motion.yaw_rate) / setup.radius
    return np.abs(np.interp(setup.sample_times[side], motion.t, spin))


def draw_wheel_noise(setup: Setup, noise: DriveNoise, side: str) -> Array:
    """Return the noise of a wheel node, (n, 6), scaled to the declared noise."""
    rng = np.random.default_rng((setup.seed, 11, SIDES.index(side)))
    drawn = noise.nodes[side].resample(wheel_spin(setup, side), setup.noise[side].rate_hz, rng)
    if setup.facing[side] != REAL_FACING[side]:
        drawn = turn_over(drawn)
    return drawn * _declared_sigma(setup)


def _draw_noise(setup: Setup, noise: DriveNoise) -> list[dict[str, Array]]:
    """Return draws of the noise of both nodes, (n, 6) each, other than that of the case."""
    others = [replace(setup, seed=setup.seed + _DRAW_SEED_STEP * (k + 1)) for k in range(_N_DRAWS)]
    return [{side: draw_wheel_noise(other, noise, side) for side in SIDES} for other in others]


def wheel_sigma(setup: Setup, noise: DriveNoise, side: str) -> Array:
    """Return the rms of the noise of a wheel node, (n, 6)."""
    spin, rate_hz = wheel_spin(setup, side), setup.noise[side].rate_hz
    rounding = np.repeat([sensor.GYRO_LSB, sensor.ACCEL_LSB], 3) / np.sqrt(12.0)
    return np.hypot(noise.nodes[side].sigma(spin, rate_hz) * _declared_sigma(setup), rounding)


def draw_bank(setup: Setup, effect: Effect | None) -> Array:
    """Return the bank of the road, (N,) rad at the times of the motion: a Gauss-Markov process along it."""
    motion = setup.drive.motion
    if effect is None or effect.name != ROAD_BANK:
        return np.zeros_like(motion.speed)
    sigma, length = effect.parameters["sigma"], effect.parameters["length"]
    path = integrate(np.abs(motion.speed), motion.step)
    spacing = 0.1  # m
    knots = np.arange(0.0, path[-1] + 2.0 * spacing, spacing)
    rng, decay = np.random.default_rng((setup.seed, 13)), np.exp(-spacing / length)
    steps = sigma * np.sqrt(1.0 - decay**2) * rng.standard_normal(len(knots))
    steps[0] = sigma * rng.standard_normal()
    values, value = np.empty(len(knots)), 0.0
    for k, noise_step in enumerate(steps.tolist()):
        value = decay * value + noise_step
        values[k] = value
    return np.interp(path, knots, values)
