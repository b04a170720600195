"""Cases: vehicle, nodes and drive from one seed, and the effects hidden in the records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gap_matrix import drives, effects, sensor, world
from gap_matrix.drives import Drive
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import Noise, Record
from gap_matrix.world import Array, Channels, Wheel

REFERENCE_STEP = 0.01  # s
# What a model file may declare beside the nominal vehicle, so that not every search starts from nothing.
KNOWN = ("gyro_bias", "accel_bias", "gyro_scale_factor", "lever_arm", "wheel_camber")


@dataclass(frozen=True)
class Setup:
    """All but the hidden effects. radius, track: m, true unless an effect says otherwise. start_angle: rad.
    taken: s, true sample times by node. known: effects that the model file declares."""

    seed: int
    radius: float
    track: float
    facing: Mapping[str, str]
    start_angle: Mapping[str, float]
    noise: Mapping[str, Noise]
    drive: Drive
    taken: Mapping[str, Array]
    known: tuple[Effect, ...] = ()
    speed_noise: float = 0.0005
    yaw_rate_noise: float = 0.0002


def setup(
    seed: int,
    kind: str = "drive",
    duration: float | None = None,
    known: Sequence[str] = (),
    vibration: float | None = None,
    speed_noise: float = 0.0005,
) -> Setup:
    """Return the setup of a seed; the drive and the noise do not depend on the hidden effect.

    duration: s, else one of drives.DURATIONS. vibration: of both nodes, else drawn. speed_noise: m/s, of the
        reference.
    """
    rng, on_road, chips = (_rng(seed, k) for k in (0, 1, 2))
    if duration is None:
        duration = float(rng.choice(drives.DURATIONS))
    drive = drives.draw(on_road, duration, kind)
    gyro, accel = 0.004 * rng.uniform(0.8, 1.4), 0.05 * rng.uniform(0.7, 1.5)
    noise = {
        side: Noise(
            gyro=round(gyro, 5),
            accel=round(accel, 4),
            vibration=chips.uniform(0.0, 0.1) if vibration is None else vibration,
            rate_hz=chips.uniform(96.0, 104.0),
            jitter=chips.uniform(0.05, 0.1),
        )
        for side in SIDES
    }
    for name in known:
        if name not in KNOWN:
            raise ValueError(f"known effect {name!r}: one of {', '.join(KNOWN)}")
    return Setup(
        seed,
        radius=round(rng.uniform(0.27, 0.34), 3),
        track=round(rng.uniform(0.75, 1.1), 3),
        facing={side: str(rng.choice(SIDES)) for side in SIDES},
        start_angle={side: rng.uniform(-np.pi, np.pi) for side in SIDES},
        noise=noise,
        drive=drive,
        taken={side: sensor.sample_times(drive.duration, noise[side], chips) for side in SIDES},
        known=tuple(effects.draw(name, _rng(seed, 5, *name.encode())) for name in known),
        speed_noise=speed_noise,
    )


def sampled_at(setup: Setup, rate_hz: float, rng: np.random.Generator, jitter: float | None = None) -> Setup:
    """Return the same drive with both nodes sampled at another rate.

    jitter: as in `Noise`, default unchanged
    """
    noise = {
        side: replace(one, rate_hz=rate_hz, jitter=one.jitter if jitter is None else jitter)
        for side, one in setup.noise.items()
    }
    taken = {side: sensor.sample_times(setup.drive.duration, one, rng) for side, one in noise.items()}
    return replace(setup, noise=noise, taken=taken)


def hidden_effect(setup: Setup, name: str, scope: str | None = None) -> Effect:
    """Return the effect drawn by this seed at its typical size.

    Raises ValueError if the model file declares it.
    """
    if name in [effect.name for effect in setup.known]:
        raise ValueError(f"{name}: already in the model file of this case")
    return effects.draw(name, _rng(setup.seed, 6, *name.encode()), scope)


def wheel(setup: Setup, node: str, present: Iterable[Effect]) -> Wheel:
    """Return the wheel of a node with the effects present, known or hidden."""
    found = effects.settings(present, node)

    def of(name: str, key: str) -> float:
        return found.get(name, {}).get(key, 0.0)

    return Wheel(
        side=1.0 if node == "left" else -1.0,
        facing=1.0 if setup.facing[node] == "left" else -1.0,
        radius=setup.radius * (1.0 + of("wheel_radius", "error")),
        track=setup.track * (1.0 + of("track_width", "error")),
        start_angle=setup.start_angle[node],
        growth=of("tyre_growth", "k"),
        slip=of("wheel_slip", "k"),
        eccentricity=of("wheel_eccentricity", "amplitude"),
        phase=of("wheel_eccentricity", "phase"),
        camber=of("wheel_camber", "angle"),
        grade=of("road_grade", "angle"),
        arm=(of("lever_arm", "x"), of("lever_arm", "y"), of("lever_arm", "z")),
    )


def channels(setup: Setup, node: str, present: Iterable[Effect], turned: float = 0.0) -> Channels:
    """Return the ideal readings of a node; `turned`: rad added to its initial wheel angle."""
    true = wheel(setup, node, present)
    return world.feel(setup.drive.motion, replace(true, start_angle=true.start_angle + turned))


def record(setup: Setup, node: str, hidden: Iterable[Effect], added: Array | float = 0.0) -> Record:
    """Return the record of a node; `added`: as in `sensor.read`."""
    present = [*setup.known, *hidden]
    return sensor.read(
        channels(setup, node, present),
        effects.settings(present, node),
        setup.taken[node],
        setup.drive.temperature,
        setup.noise[node],
        _rng(setup.seed, 3, SIDES.index(node)),
        added,
    )


def reference(setup: Setup) -> Array:
    """Return (n, 4): t, speed, yaw rate, temperature; speed and yaw rate with their declared noise."""
    motion, rng = setup.drive.motion, _rng(setup.seed, 4)
    every = round(REFERENCE_STEP / motion.step)
    rows = np.stack([motion.t, motion.speed, motion.yaw_rate, setup.drive.temperature], 1)[::every]
    rows[:, 1:3] += rng.standard_normal((len(rows), 2)) * [setup.speed_noise, setup.yaw_rate_noise]
    return rows


def _rng(*key: int) -> np.random.Generator:
    return np.random.default_rng(key)
