"""What anybody could see of an effect in one drive who knows its name, its scope and its sign: the limit.

An effect that moves the mean: the likelihood-ratio test of its coordinates, everything that the model leaves
free refitted, from the very matrices that `gap` screens with. Far from nothing its statistic is a non-central
chi square, whose non-centrality is the information about the effect times the square of its size (Wald 1943);
with one coordinate its sign is known, too, and the test is one-sided. An effect of chance: see `chance.py`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import ncx2, norm

from gap_matrix import cases, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import Meter
from gap_matrix.effects import KINDS, SIDES, VEHICLE, Effect, scaled
from gap_matrix.limit import chance
from gap_matrix.limit.trial import in_whole_hits
from gap_matrix.world import Array
from hubodo.effects import BY_NAME
from hubodo.effects import Effect as HubodoEffect
from hubodo.effects.warmup import GyroWarmup
from hubodo.gap.judge.search import initial_state
from hubodo.gap.linear.linearised import linearise
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.build import build
from hubodo.gap.process_noise.point import Point
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.screen.candidates import Candidate, all_directions, candidates
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Chance of a false alarm in a log: what `gap` promises, which names nothing that chance does as often.
FALSE_ALARM = 0.01
# Names in scopes that share it (Bonferroni): left, right, all, or the vehicle.
CANDIDATES = sum(1 if name in VEHICLE else len(SIDES) + 1 for name in KINDS)
SHARED = FALSE_ALARM / CANDIDATES
# Sizes at which the power is worked out, times the one that is seen in every second such log.
SPREAD = np.exp(np.linspace(-1.6, 1.2, 29))


@dataclass(frozen=True)
class Seen:
    """What the matrices of a drive say of one effect at its typical size.

    centre: non-centrality. freedom: its coordinates that are seen at all. beside, rival: non-centrality that
    is left beside the other name that imitates it best, in any scope, and that name.
    """

    centre: float
    freedom: int
    beside: float
    rival: str


@dataclass(frozen=True)
class Power:
    """How often an effect is seen in one drive.

    factors: (G,) times its typical size. one: (G,) share of logs in which a test of it alone sees it, with
    the false alarms of a whole log. priced: the same where all names in all scopes share these. seen: of what
    moves the mean. least: the factor of a single hit, of what comes in hits.
    """

    factors: Array
    one: Array
    priced: Array
    seen: Seen | None = None
    least: float = 0.0

    @property
    def half(self) -> float:
        """The factor that is seen in half of such logs, all names sharing the false alarms."""
        return half_seen(self.factors, self.priced)


def half_seen(factors: Sequence[float] | Array, share: Sequence[float] | Array) -> float:
    """The factor at which a share that grows with it is one half."""
    return float(np.exp(np.interp(0.5, share, np.log(factors))))


def oracle(setup: Setup, names: Sequence[str] = tuple(KINDS)) -> dict[str, Power]:
    """By name, in a drive in which nothing is hidden; the effects as its seed draws them."""
    hidden = {name: cases.hidden_effect(setup, name) for name in names}
    shown = [effect for name, effect in hidden.items() if name not in chance.EFFECTS]
    seen = informations(_nothing_hidden(setup), shown) if shown else {}
    meter, powers = Meter(setup), dict[str, Power]()
    for name, effect in hidden.items():
        powers[name] = _of_mean(seen[name]) if name in seen else _of_chance(setup, meter, effect)
    return powers


def _nothing_hidden(setup: Setup) -> Point:
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write(setup, [], Path(folder), {})
        problem = build(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
    return refit_with_weights(initial_state(problem)).point


def informations(point: Point, hidden: Sequence[Effect]) -> dict[str, Seen]:
    """By name."""
    begins = {effect.name: _begin(effect) for effect in hidden}
    directions = all_directions(point.state)
    for seed in begins.values():
        if isinstance(seed, GyroWarmup):
            directions += [Direction(seed, node.name, k) for node in point.problem.nodes for k in range(3)]
    gram = linearise(point, directions).gram
    everything = candidates(point.problem, directions)
    made = {}
    for effect in hidden:
        begin = begins[effect.name]
        own = next(it for it in everything if (it.term.effect, it.term.scope) == (begin, effect.scope))
        moved = BY_NAME[effect.name](**effect.parameters).coordinates() - begin.coordinates()
        others = [it for it in everything if it.name != effect.name]
        made[effect.name] = _seen(gram[:-1, :-1], own, moved / begin.coordinate_scales(), others)
    return made


def _begin(effect: Effect) -> HubodoEffect:
    """The effect of the product where it is absent; what says what it is like is known."""
    if effect.name == "gyro_warmup":
        return GyroWarmup(time_constant=effect.parameters["time_constant"])
    return BY_NAME[effect.name].seeds()[0]


def _seen(gram: Array, own: Candidate, value: Array, others: Sequence[Candidate]) -> Seen:
    """gram: (D, D) of the directions, walks taken out. value: (k,) in scales."""
    along = own.basis @ value[: own.basis.shape[1]]
    centre = float(along @ gram @ along)
    inner = own.basis.T @ gram @ own.basis
    left = {other.name: centre for other in others}
    for other in others:
        cross = other.basis.T @ gram @ along
        taken = cross @ np.linalg.pinv(other.basis.T @ gram @ other.basis, 1e-9, hermitian=True) @ cross
        left[other.name] = min(left[other.name], centre - float(taken))
    rival = min(left, key=lambda name: left[name])
    seen = int(np.count_nonzero(np.linalg.eigvalsh(inner) > 1e-3))
    return Seen(centre, seen, max(left[rival], 0.0), rival)


def _of_mean(seen: Seen) -> Power:
    """Power along the size."""
    freedom = seen.freedom

    def power(centre: Array, alarm: float) -> Array:
        if freedom == 1:
            return np.asarray(norm.sf(norm.isf(alarm) - np.sqrt(centre)))
        return np.asarray(ncx2.sf(ncx2.isf(alarm, freedom, 0.0), freedom, centre))

    grid = np.geomspace(1e-2, 300.0, 400)
    half = float(np.interp(0.5, power(grid, SHARED), grid))
    factors = SPREAD * np.sqrt(half / seen.centre)
    centre = factors**2 * seen.centre
    return Power(factors, power(centre, FALSE_ALARM), power(centre, SHARED), seen)


def _of_chance(setup: Setup, meter: Meter, effect: Effect) -> Power:
    """Power along the size, from draws of the statistic where the effect is there."""

    def power(factor: float) -> tuple[float, float]:
        drawn = chance.statistic(setup, meter, scaled(effect, factor), np.random.default_rng(setup.seed))
        return tuple(float(np.mean(drawn > chance.threshold(drawn, one))) for one in (FALSE_ALARM, SHARED))

    # Hits come in whole ones: nothing is smaller than the first.
    least = in_whole_hits(setup, effect, 0.0)
    low, high = max(least, 1e-2), 1e2
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if power(middle)[1] < 0.5 else (low, middle)
    factors = SPREAD[::2] * np.sqrt(low * high)
    factors = np.sort(np.append(factors[factors > 0.995 * least], 0.99 * least if least else []))
    both = np.array([power(float(factor)) if factor > 0.995 * least else (0.0, 0.0) for factor in factors])
    both = np.maximum.accumulate(both, axis=0)
    return Power(factors, both[:, 0], both[:, 1], least=least)
