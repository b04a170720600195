"""Cases: vehicle, nodes and drive drawn from one seed, and simulated records with hidden effects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gap_matrix import drives, effects, sensor, world
from gap_matrix.drives import Drive
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import Noise, Record
from gap_matrix.world import Array, IdealReadings, Wheel

REFERENCE_STEP = 0.01  # s
# Effects that a model file may declare, so that some searches start from a model with effects.
DECLARABLE_EFFECTS = ("gyro_bias", "accel_bias", "gyro_scale_factor", "lever_arm", "wheel_camber")


@dataclass(frozen=True)
class Setup:
    """A simulated case without its hidden effects.

    radius, track: nominal dimensions, m; effects change the true ones
    facing: `left` or `right` by node: direction of its z axis
    start_angle: initial wheel angle by node, rad
    sample_times: true sample times by node, s
    known: effects that the model file declares
    speed_noise, yaw_rate_noise: 1 sigma of the reference, m/s and rad/s
    """

    seed: int
    radius: float
    track: float
    facing: Mapping[str, str]
    start_angle: Mapping[str, float]
    noise: Mapping[str, Noise]
    drive: Drive
    sample_times: Mapping[str, Array]
    known: tuple[Effect, ...] = ()
    speed_noise: float = 0.0005
    yaw_rate_noise: float = 0.0002


def draw_setup(
    seed: int,
    kind: str = "drive",
    duration: float | None = None,
    known: Sequence[str] = (),
    vibration: float | None = None,
    speed_noise: float = 0.0005,
) -> Setup:
    """Return the setup of a seed; the drive and the noise do not depend on the hidden effect.

    kind: one of drives.KINDS
    duration: s, default one of drives.DURATIONS
    known: names of effects that the model file declares
    vibration: of both nodes, as in `Noise`, default drawn
    speed_noise: 1 sigma of the reference, m/s

    Raises ValueError if a known effect is not one of DECLARABLE_EFFECTS.
    """
    rng, drive_rng, node_rng = (_rng(seed, k) for k in (0, 1, 2))
    if duration is None:
        duration = float(rng.choice(drives.DURATIONS))
    drive = drives.draw_drive(drive_rng, duration, kind)
    gyro, accel = 0.004 * rng.uniform(0.8, 1.4), 0.05 * rng.uniform(0.7, 1.5)
    noise = {
        side: Noise(
            gyro=round(gyro, 5),
            accel=round(accel, 4),
            vibration=node_rng.uniform(0.0, 0.1) if vibration is None else vibration,
            rate_hz=node_rng.uniform(96.0, 104.0),
            jitter=node_rng.uniform(0.05, 0.1),
        )
        for side in SIDES
    }
    for name in known:
        if name not in DECLARABLE_EFFECTS:
            raise ValueError(f"known effect {name!r}: one of {', '.join(DECLARABLE_EFFECTS)}")
    return Setup(
        seed,
        radius=round(rng.uniform(0.27, 0.34), 3),
        track=round(rng.uniform(0.75, 1.1), 3),
        facing={side: str(rng.choice(SIDES)) for side in SIDES},
        start_angle={side: rng.uniform(-np.pi, np.pi) for side in SIDES},
        noise=noise,
        drive=drive,
        sample_times={
            side: sensor.draw_sample_times(drive.duration, noise[side], node_rng) for side in SIDES
        },
        known=tuple(effects.draw_effect(name, _rng(seed, 5, *name.encode())) for name in known),
        speed_noise=speed_noise,
    )


def resample_nodes(
    setup: Setup, rate_hz: float, rng: np.random.Generator, jitter: float | None = None
) -> Setup:
    """Return the same setup with both nodes sampled at another rate.

    jitter: as in `Noise`, default unchanged
    """
    noise = {
        side: replace(node_noise, rate_hz=rate_hz, jitter=node_noise.jitter if jitter is None else jitter)
        for side, node_noise in setup.noise.items()
    }
    sample_times = {
        side: sensor.draw_sample_times(setup.drive.duration, node_noise, rng)
        for side, node_noise in noise.items()
    }
    return replace(setup, noise=noise, sample_times=sample_times)


def draw_hidden_effect(setup: Setup, name: str, scope: str | None = None) -> Effect:
    """Return an effect drawn by the seed at its typical size.

    Raises ValueError if the model file declares the effect already.
    """
    if name in [effect.name for effect in setup.known]:
        raise ValueError(f"{name}: already in the model file of this case")
    return effects.draw_effect(name, _rng(setup.seed, 6, *name.encode()), scope)


def build_wheel(setup: Setup, node: str, present: Iterable[Effect]) -> Wheel:
    """Return the true wheel of a node with its known and hidden effects."""
    parameters = effects.parameters_on_node(present, node)

    def parameter_of(name: str, key: str) -> float:
        return parameters.get(name, {}).get(key, 0.0)

    return Wheel(
        side=1.0 if node == "left" else -1.0,
        facing=1.0 if setup.facing[node] == "left" else -1.0,
        radius=setup.radius * (1.0 + parameter_of("wheel_radius", "error")),
        track=setup.track * (1.0 + parameter_of("track_width", "error")),
        start_angle=setup.start_angle[node],
        growth=parameter_of("tyre_growth", "k"),
        slip=parameter_of("wheel_slip", "k"),
        eccentricity=parameter_of("wheel_eccentricity", "amplitude"),
        phase=parameter_of("wheel_eccentricity", "phase"),
        camber=parameter_of("wheel_camber", "angle"),
        grade=parameter_of("road_grade", "angle"),
        arm=(parameter_of("lever_arm", "x"), parameter_of("lever_arm", "y"), parameter_of("lever_arm", "z")),
    )


def compute_node_readings(
    setup: Setup, node: str, present: Iterable[Effect], angle_offset: float = 0.0
) -> IdealReadings:
    """Return the ideal readings of a node.

    present: effects of the node, known and hidden
    angle_offset: offset of the initial wheel angle, rad
    """
    wheel = build_wheel(setup, node, present)
    return world.compute_ideal_readings(
        setup.drive.motion, replace(wheel, start_angle=wheel.start_angle + angle_offset)
    )


def simulate_node_record(
    setup: Setup, node: str, hidden: Iterable[Effect], added: Array | float = 0.0
) -> Record:
    """Return the simulated record of a node; `added` as in `sensor.simulate_record`."""
    present = [*setup.known, *hidden]
    return sensor.simulate_record(
        compute_node_readings(setup, node, present),
        effects.parameters_on_node(present, node),
        setup.sample_times[node],
        setup.drive.temperature,
        setup.noise[node],
        _rng(setup.seed, 3, SIDES.index(node)),
        added,
    )


def simulate_reference(setup: Setup) -> Array:
    """Return the reference (n, 4): t, speed, yaw rate with their declared noise, and temperature."""
    motion, rng = setup.drive.motion, _rng(setup.seed, 4)
    stride = round(REFERENCE_STEP / motion.step)
    rows = np.stack([motion.t, motion.speed, motion.yaw_rate, setup.drive.temperature], 1)[::stride]
    rows[:, 1:3] += rng.standard_normal((len(rows), 2)) * [setup.speed_noise, setup.yaw_rate_noise]
    return rows


def _rng(*key: int) -> np.random.Generator:
    return np.random.default_rng(key)
