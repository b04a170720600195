"""Trials of reliability: short logs of many kinds by the independent simulator, from one seed each.

What is hidden is drawn from faint to strong, on drives that show everything and on blunt ones that do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gap_matrix import alike, cases, effects, outside, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import Meter
from gap_matrix.drives import Drive
from gap_matrix.effects import SIDES, Effect
from gap_matrix.world import Motion

# Of a hundred trials, how many are of each kind.
MIX = {"single": 44, "pair": 12, "null": 12, "outside": 8, "alike": 6, "blunt alike": 6, "blunt": 12}
KINDS = (*MIX, "several")
SECONDS = (33.0, 46.0)
# Half of what nodes mostly sample at: as much is hidden in it, in half the time.
RATE_HZ = (48.0, 52.0)
FAINTEST, STRONGEST = 8.0, 3000.0  # nats
BLUNT = ("straight", "constant speed", "straight at constant speed", "circle", "short")
_SHORT = (21.0, 28.0)  # s
# Effects of which no seed of a drive shows enough are drawn again so often.
_DRAWS = 30


@dataclass(frozen=True)
class Trial:
    """The hidden effects of a log, and the form of the log.

    hidden: of the vocabulary; outsider: what is not. dead: as in `alike.Pair`.
    """

    kind: str
    setup: Setup
    words: str
    hidden: tuple[Effect, ...] = ()
    outsider: outside.Outsider | None = None
    dead: str = ""

    @cached_property
    def meter(self) -> Meter:
        return Meter(self.setup, dead=self.dead)

    def lost(self, effect: Effect, scope: str) -> float:
        """Nats by which a hidden effect stays ahead of itself in another scope."""
        return lost(self.meter, effect, scope)

    def write(self, folder: Path) -> None:
        """The files of the log, as `recording.write`."""
        records = alike.records(self.setup, self.hidden, self.dead)
        if self.outsider is not None:
            records = outside.records(self.setup, self.outsider)
        recording.write(self.setup, self.hidden, folder, {}, records)


def kinds(count: int, mix: Mapping[str, int] = MIX) -> list[str]:
    """Return the kinds of `count` trials, evenly mixed also in the first trials."""
    share = {kind: weight / sum(mix.values()) for kind, weight in mix.items()}
    made: list[str] = []
    for k in range(count):
        made.append(max(share, key=lambda kind: share[kind] * (k + 1) - made.count(kind)))
    return made


def trial(seed: int, kind: str) -> Trial:
    """Return the trial of a seed. Raises ValueError if kind is not one of KINDS."""
    rng = np.random.default_rng((seed, 20))
    if kind == "null":
        form = str(rng.choice(["drive", "drive", "drive", "bench", "turntable"]))
        known = ["lever_arm", "gyro_scale_factor"] if rng.random() < 0.25 else []
        return Trial(kind, _setup(seed, rng, form, known), form)
    if kind == "outside":
        setup, name = _setup(seed, rng), str(rng.choice(list(outside.KINDS)))
        strength = str(rng.choice(list(outside.NATS)))
        return Trial(kind, setup, f"{name}, {strength}", outsider=outside.hide(setup, name, strength))
    if kind in ("alike", "blunt alike"):
        return _alike(seed, rng, kind)
    setup, words = _setup(seed, rng), ""
    if kind == "blunt":
        words = str(rng.choice(BLUNT))
        setup = _blunt(setup, rng, words)
    elif kind not in KINDS:
        raise ValueError(f"kind {kind!r}: one of {', '.join(KINDS)}")
    count = {"pair": 2, "several": int(rng.integers(3, 6))}.get(kind, 1)
    made = Trial(kind, setup, words)
    return replace(made, hidden=_drawn(made, rng, count))


def _setup(seed, rng, form="drive", known: Sequence[str] = ()) -> Setup:
    made = cases.setup(seed, form, rng.uniform(*SECONDS), known)
    return cases.sampled_at(made, rng.uniform(*RATE_HZ), rng)


def _blunt(setup: Setup, rng: np.random.Generator, words: str) -> Setup:
    """Return the same log on a less informative drive."""
    motion = setup.drive.motion
    still, speed = np.zeros(len(motion.t)), np.full(len(motion.t), rng.uniform(1.5, 4.0))
    turn = still + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5)
    end = round(rng.uniform(*_SHORT) / motion.step)
    moved = {
        "straight": Motion(motion.speed, still),
        "constant speed": Motion(speed, motion.yaw_rate),
        "straight at constant speed": Motion(speed, still),
        "circle": Motion(speed, turn),
        "short": Motion(motion.speed[:end], motion.yaw_rate[:end]),
    }[words]
    warmth = setup.drive.temperature[: len(moved.t)]
    return cases.sampled_at(replace(setup, drive=Drive(moved, warmth, "drive")), rng.uniform(*RATE_HZ), rng)


def _drawn(made: Trial, rng: np.random.Generator, count: int) -> tuple[Effect, ...]:
    """Draw effects, each at a visible size; those that the drive cannot show are drawn again."""
    low = {"several": np.log(150.0)}.get(made.kind, np.log(FAINTEST))
    hidden: list[Effect] = []
    for _ in range(_DRAWS):
        name = str(rng.choice([it for it in effects.KINDS if it not in [one.name for one in hidden]]))
        nats = float(np.exp(rng.uniform(low, np.log(STRONGEST))))
        try:
            hidden.append(made.meter.dose(cases.hidden_effect(made.setup, name), nats)[0])
        except ValueError:
            continue
        if len(hidden) == count:
            return tuple(hidden)
    raise RuntimeError(f"seed {made.setup.seed}: no drive of this kind shows {count} effects")


def _alike(seed: int, rng: np.random.Generator, kind: str) -> Trial:
    pair = alike.PAIRS[int(rng.integers(len(alike.PAIRS)))]
    hidden, other = (pair.one, pair.other)[:: int(rng.choice([-1, 1]))]
    nats = float(np.exp(rng.uniform(np.log(30.0), np.log(600.0))))
    if kind == "blunt alike":
        setup = alike.blunt(seed, pair, rng.uniform(*SECONDS))
        made = Trial(kind, cases.sampled_at(setup, rng.uniform(*RATE_HZ), rng), pair.why, dead=pair.dead)
    else:
        made = Trial(kind, _setup(seed, rng), f"beside {other.name}")
        hidden = cases.hidden_effect(made.setup, hidden.name, hidden.scope)
    return replace(made, hidden=(made.meter.dose(hidden, nats)[0],))


def lost(meter: Meter, effect: Effect, scope: str) -> float:
    """Return the nats by which an effect beats itself in another scope of the same size."""
    if scope == effect.scope or "vehicle" in (scope, effect.scope):
        return 0.0
    gain = {node: meter.gain(replace(effect, scope=node)) for node in SIDES}
    if effect.scope == "all":
        return gain[next(node for node in SIDES if node != scope)]
    other = next(node for node in SIDES if node != effect.scope)
    if scope != "all":
        return gain[effect.scope]
    return gain[effect.scope] * gain[other] / max(gain[effect.scope] + gain[other], 1e-12)
