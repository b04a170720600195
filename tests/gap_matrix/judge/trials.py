"""Trials of reliability: short logs of many kinds by the independent simulator, each drawn from one seed.

The hidden effects are faint to strong, on informative drives and on ambiguous ("blunt") ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gap_matrix import alike, cases, effects, outside, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import GainMeter
from gap_matrix.drives import Drive
from gap_matrix.effects import SIDES, Effect
from gap_matrix.world import Motion

# Number of trials of each kind in a hundred.
PERCENT_BY_KIND = {
    "single": 44,
    "pair": 12,
    "null": 12,
    "outside": 8,
    "alike": 6,
    "blunt alike": 6,
    "blunt": 12,
}
KINDS = (*PERCENT_BY_KIND, "several")
DURATION_RANGE_S = (33.0, 46.0)
# Half the usual sample rate: with the same gain in nats, a trial takes half the time.
RATE_RANGE_HZ = (48.0, 52.0)
MIN_NATS, MAX_NATS = 8.0, 3000.0  # nats
AMBIGUOUS_DRIVES = ("straight", "constant speed", "straight at constant speed", "circle", "short")
_SHORT_RANGE_S = (21.0, 28.0)  # s
# Largest number of draws of an effect that the drive shows.
_MAX_DRAWS = 30


@dataclass(frozen=True)
class Trial:
    """A log with hidden effects.

    description: of the drive or of the effect, as printed
    hidden: effects of the vocabulary
    outside_effect: an effect outside the vocabulary
    dead_sensor: as in `alike.ConfusablePair`
    """

    kind: str
    setup: Setup
    description: str
    hidden: tuple[Effect, ...] = ()
    outside_effect: outside.OutsideEffect | None = None
    dead_sensor: str = ""

    @cached_property
    def meter(self) -> GainMeter:
        """Return the meter of gains in this log."""
        return GainMeter(self.setup, dead_sensor=self.dead_sensor)

    def scope_advantage(self, effect: Effect, scope: str) -> float:
        """Return the gain of a hidden effect over the same effect in another scope, in nats."""
        return compute_scope_advantage(self.meter, effect, scope)

    def write(self, folder: Path) -> None:
        """Write the files of the log, as `recording.write_case_files`."""
        records = alike.simulate_records(self.setup, self.hidden, self.dead_sensor)
        if self.outside_effect is not None:
            records = outside.simulate_records(self.setup, self.outside_effect)
        recording.write_case_files(self.setup, self.hidden, folder, {}, records)


def mix_kinds(count: int, mix: Mapping[str, int] = PERCENT_BY_KIND) -> list[str]:
    """Return the kinds of `count` trials, mixed evenly from the first trial on."""
    share = {kind: weight / sum(mix.values()) for kind, weight in mix.items()}
    kinds: list[str] = []
    for k in range(count):
        kinds.append(max(share, key=lambda kind: share[kind] * (k + 1) - kinds.count(kind)))
    return kinds


def draw_trial(seed: int, kind: str) -> Trial:
    """Return the trial of a seed. Raises ValueError if kind is not one of KINDS."""
    rng = np.random.default_rng((seed, 20))
    if kind == "null":
        drive_kind = str(rng.choice(["drive", "drive", "drive", "bench", "turntable"]))
        known = ["lever_arm", "gyro_scale_factor"] if rng.random() < 0.25 else []
        return Trial(kind, _draw_trial_setup(seed, rng, drive_kind, known), drive_kind)
    if kind == "outside":
        setup, name = _draw_trial_setup(seed, rng), str(rng.choice(list(outside.KINDS)))
        strength = str(rng.choice(list(outside.NATS)))
        return Trial(
            kind, setup, f"{name}, {strength}", outside_effect=outside.hide_effect(setup, name, strength)
        )
    if kind in ("alike", "blunt alike"):
        return _draw_confusable(seed, rng, kind)
    setup, description = _draw_trial_setup(seed, rng), ""
    if kind == "blunt":
        description = str(rng.choice(AMBIGUOUS_DRIVES))
        setup = _make_ambiguous(setup, rng, description)
    elif kind not in KINDS:
        raise ValueError(f"kind {kind!r}: one of {', '.join(KINDS)}")
    count = {"pair": 2, "several": int(rng.integers(3, 6))}.get(kind, 1)
    trial = Trial(kind, setup, description)
    return replace(trial, hidden=_draw_effects(trial, rng, count))


def _draw_trial_setup(seed, rng, drive_kind="drive", known: Sequence[str] = ()) -> Setup:
    """Return a setup of random duration and sample rate."""
    setup = cases.draw_setup(seed, drive_kind, rng.uniform(*DURATION_RANGE_S), known)
    return cases.resample_nodes(setup, rng.uniform(*RATE_RANGE_HZ), rng)


def _make_ambiguous(setup: Setup, rng: np.random.Generator, description: str) -> Setup:
    """Return the same setup on an ambiguous drive, one of AMBIGUOUS_DRIVES."""
    motion = setup.drive.motion
    zeros, speed = np.zeros(len(motion.t)), np.full(len(motion.t), rng.uniform(1.5, 4.0))
    yaw_rate = zeros + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5)
    end = round(rng.uniform(*_SHORT_RANGE_S) / motion.step)
    ambiguous_motion = {
        "straight": Motion(motion.speed, zeros),
        "constant speed": Motion(speed, motion.yaw_rate),
        "straight at constant speed": Motion(speed, zeros),
        "circle": Motion(speed, yaw_rate),
        "short": Motion(motion.speed[:end], motion.yaw_rate[:end]),
    }[description]
    temperature = setup.drive.temperature[: len(ambiguous_motion.t)]
    return cases.resample_nodes(
        replace(setup, drive=Drive(ambiguous_motion, temperature, "drive")), rng.uniform(*RATE_RANGE_HZ), rng
    )


def _draw_effects(trial: Trial, rng: np.random.Generator, count: int) -> tuple[Effect, ...]:
    """Return random effects, each at a visible size; an effect that the drive cannot show is drawn again."""
    log_min_nats = {"several": np.log(150.0)}.get(trial.kind, np.log(MIN_NATS))
    hidden: list[Effect] = []
    for _ in range(_MAX_DRAWS):
        name = str(
            rng.choice([name for name in effects.KINDS if name not in [effect.name for effect in hidden]])
        )
        nats = float(np.exp(rng.uniform(log_min_nats, np.log(MAX_NATS))))
        try:
            hidden.append(trial.meter.scale_to_gain(cases.draw_hidden_effect(trial.setup, name), nats)[0])
        except ValueError:
            continue
        if len(hidden) == count:
            return tuple(hidden)
    raise RuntimeError(f"seed {trial.setup.seed}: no drive of this kind shows {count} effects")


def _draw_confusable(seed: int, rng: np.random.Generator, kind: str) -> Trial:
    """Return a trial with one effect of a confusable pair."""
    pair = alike.CONFUSABLE_PAIRS[int(rng.integers(len(alike.CONFUSABLE_PAIRS)))]
    hidden, alternative = (pair.first, pair.second)[:: int(rng.choice([-1, 1]))]
    nats = float(np.exp(rng.uniform(np.log(30.0), np.log(600.0))))
    if kind == "blunt alike":
        setup = alike.draw_ambiguous_setup(seed, pair, rng.uniform(*DURATION_RANGE_S))
        trial = Trial(
            kind,
            cases.resample_nodes(setup, rng.uniform(*RATE_RANGE_HZ), rng),
            pair.reason,
            dead_sensor=pair.dead_sensor,
        )
    else:
        trial = Trial(kind, _draw_trial_setup(seed, rng), f"beside {alternative.name}")
        hidden = cases.draw_hidden_effect(trial.setup, hidden.name, hidden.scope)
    return replace(trial, hidden=(trial.meter.scale_to_gain(hidden, nats)[0],))


def compute_scope_advantage(meter: GainMeter, effect: Effect, scope: str) -> float:
    """Return the gain of an effect over the same effect in another scope, in nats."""
    if scope == effect.scope or "vehicle" in (scope, effect.scope):
        return 0.0
    gain_by_node = {node: meter.gain(replace(effect, scope=node)) for node in SIDES}
    if effect.scope == "all":
        return gain_by_node[next(node for node in SIDES if node != scope)]
    other_node = next(node for node in SIDES if node != effect.scope)
    if scope != "all":
        return gain_by_node[effect.scope]
    return (
        gain_by_node[effect.scope]
        * gain_by_node[other_node]
        / max(gain_by_node[effect.scope] + gain_by_node[other_node], 1e-12)
    )
