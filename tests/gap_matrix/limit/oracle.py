"""The oracle: detection limit of an effect in one drive if name, scope and sign are known.

An effect that moves the mean: the likelihood-ratio test of its coordinates, everything that the model leaves
    free refitted, from the very matrices that `gap` screens with. Far from nothing its statistic is a
    non-central chi square, whose non-centrality is the information about the effect times the square of its
    size (Wald 1943); with one coordinate its sign is known, too, and the test is one-sided. An effect of
    chance: see `chance.py`. Whoever does not know the name has to choose it among all, too: told is what is
    seen and chosen (`choice.py`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import ncx2, norm

from gap_matrix import cases, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import Meter
from gap_matrix.effects import KINDS, SIDES, VEHICLE, Effect, scaled
from gap_matrix.limit import chance, choice
from gap_matrix.limit.choice import Choice, Option
from gap_matrix.limit.trial import in_whole_hits
from gap_matrix.world import Array
from hubodo.effects import BY_NAME
from hubodo.effects import Effect as HubodoEffect
from hubodo.effects.empirical import PREFIX, empirical
from hubodo.effects.warmup import GyroWarmup
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.linear.linearisation import linearise
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.screen.candidates import list_candidates, list_directions
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Chance of a false alarm in a log: what `gap` promises, which names nothing that chance does as often.
FALSE_ALARM = 0.01
# Names in scopes that share it (Bonferroni): left, right, all, or the vehicle.
CANDIDATES = sum(1 if name in VEHICLE else len(SIDES) + 1 for name in KINDS)
SHARED = FALSE_ALARM / CANDIDATES
# Sizes at which the power is worked out, times the one that is seen in every second such log.
SPREAD = np.exp(np.linspace(-1.6, 2.6, 43))
# Slowest waves of a walk that may pass for something else, or the other way round.
WAVES = 12
WALK = "gyro_rate_random_walk"
# Its usual size, rad/s/√s, and the scale of the waves, rad/s.
TYPICAL_WALK, WAVE_SCALE = 5e-4, 0.01


@dataclass(frozen=True)
class Seen:
    """Matrices of a drive for one effect at its typical size.

    centre: non-centrality. freedom: its coordinates that are seen at all.
    """

    centre: float
    freedom: int


@dataclass(frozen=True)
class Power:
    """Detection probability of an effect in one drive, by size.

    factors: (G,) times its typical size. one: (G,) share of logs in which a test of it alone sees it, with
        the false alarms of a whole log. priced: the same where all names in all scopes share these. told:
        seen so, and its name and scope more probable than all others together. rival: what is most probable
        beside, where half are told. seen: of what moves the mean. least: the factor of a single hit, of what
        comes in hits.
    """

    factors: Array
    one: Array
    priced: Array
    told: Array
    rival: str = ""
    seen: Seen | None = None
    least: float = 0.0

    @property
    def half(self) -> float:
        """The factor that is seen in half of such logs, all names sharing the false alarms."""
        return half_seen(self.factors, self.priced)


def half_seen(factors: Sequence[float] | Array, share: Sequence[float] | Array) -> float:
    """Return the factor at which an increasing share equals one half."""
    return float(np.exp(np.interp(0.5, share, np.log(factors))))


def oracle(setup: Setup, names: Sequence[str] = tuple(KINDS)) -> dict[str, Power]:
    """Return the powers by name, in a drive without hidden effects; the effects are drawn by its seed."""
    hidden = {name: cases.hidden_effect(setup, name) for name in names}
    of_mean = [effect for name, effect in hidden.items() if name not in chance.EFFECTS]
    walk = hidden.get(WALK)
    made = _Linear(_nothing_hidden(setup), of_mean, setup.seed) if of_mean or walk else None
    meter, powers = Meter(setup), dict[str, Power]()
    for name, effect in hidden.items():
        if name not in chance.EFFECTS and made is not None:
            powers[name] = made.power(effect)
            continue
        power = _of_chance(setup, meter, effect)
        powers[name] = made.chosen_walk(effect, power) if name == WALK and made is not None else power
    return powers


def _nothing_hidden(setup: Setup) -> Evaluation:
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write(setup, [], Path(folder), {})
        problem = build_problem(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
    return refit_with_weights(build_initial_state(problem)).evaluation


class _Linear:
    """A drive as a linear model: sensitivity of the mean, and slow waves that make up random walks."""

    def __init__(self, point: Evaluation, hidden: Sequence[Effect], seed: int) -> None:
        nodes = [node.name for node in point.problem.nodes]
        self._begins = {effect.name: _begin(effect) for effect in hidden}
        directions = list_directions(point.state)
        for begin in self._begins.values():
            if isinstance(begin, GyroWarmup):
                directions += [Direction(begin, node, k) for node in nodes for k in range(3)]
        self._length = max(float(np.ptp(node.t)) for node in point.problem.nodes)
        first = len(directions)
        for node in nodes:
            for wave in range(WAVES):
                effect = empirical(
                    f"{PREFIX}gx,gy,gz ~ cos(2*pi*{(wave + 0.5) / 2.0 / self._length:.6f}*t)"
                )()
                # Of cosine and sine, the sine.
                directions += [Direction(effect, node, k) for k in (1, 3, 5)]
        whole = linearise(point, directions).gram
        self._gram = whole[:-1, :-1]
        each = WAVES * 3
        self._waves = {
            node: np.arange(first + k * each, first + (k + 1) * each) for k, node in enumerate(nodes)
        }
        self._waves["all"] = np.arange(first, len(directions))
        self._means = [it for it in list_candidates(point.problem, directions) if it.name in KINDS]
        options = [Option(it.name, it.term.scope, it.basis, np.ones(it.basis.shape[1])) for it in self._means]
        options += [
            Option(WALK, scope, np.eye(len(directions))[:, at], self._wave_sigmas(TYPICAL_WALK, len(at)))
            for scope, at in self._waves.items()
        ]
        self._choice = Choice(self._gram, options, np.random.default_rng((seed, 30)))

    def _wave_sigmas(self, k: float, count: int) -> Array:
        """(count,) 1 sigma of the sines of a walk (Karhunen-Loève), in scales; three axes to each wave."""
        wave = np.repeat(np.arange(WAVES) + 0.5, 3)
        return np.resize(k * np.sqrt(2.0 * self._length) / (np.pi * wave) / WAVE_SCALE, count)

    def power(self, effect: Effect) -> Power:
        """Of what moves the mean, along the size."""
        begin = self._begins[effect.name]
        own = next(it for it in self._means if (it.term.effect, it.term.scope) == (begin, effect.scope))
        moved = BY_NAME[effect.name](**effect.parameters).coordinates() - begin.coordinates()
        value = (moved / begin.coordinate_scales())[: own.basis.shape[1]]
        along = own.basis @ value
        inner = own.basis.T @ self._gram @ own.basis
        centre = float(along @ self._gram @ along)
        seen = Seen(centre, int(np.count_nonzero(np.linalg.eigvalsh(inner) > 1e-3)))

        def told(factor: float) -> tuple[float, str]:
            chosen, rival = self._choice.told(along, factor, effect.name, effect.scope)
            scores = self._choice.scores(factor * along)
            there = choice.seen(scores, self._gram, own.basis, value, SHARED)
            return float(np.mean(chosen & there)), rival

        return _of_mean(seen, told)

    def chosen_walk(self, effect: Effect, power: Power) -> Power:
        """The power of a walk with the share that is told: its waves are drawn, each in every draw."""
        at, rng = self._waves[effect.scope], np.random.default_rng((len(self._gram), 31))
        along = np.zeros((choice.DRAWS, len(self._gram)))
        sigmas = self._wave_sigmas(effect.parameters["k"], len(at))
        along[:, at] = sigmas * rng.standard_normal((choice.DRAWS, len(at)))

        def told(factor: float) -> tuple[float, str]:
            chosen, rival = self._choice.told(along, factor, WALK, effect.scope)
            spread, axes = np.linalg.eigh((self._gram[np.ix_(at, at)] * sigmas).T * sigmas * factor**2)
            spread = np.maximum(spread, 0.0)
            scores = self._choice.scores(factor * along)[:, at] * sigmas * factor
            drawn = 0.5 * ((scores @ axes) ** 2 @ (1.0 / (1.0 + spread)) - np.sum(np.log1p(spread)))
            return float(np.mean(chosen & (drawn > chance.threshold(drawn, SHARED)))), rival

        shares, rival = _along(power.factors, told)
        return replace(power, told=shares, rival=rival)


def _begin(effect: Effect) -> HubodoEffect:
    """Return the product's effect at zero, with the parameters that are known."""
    if effect.name == "gyro_warmup":
        return GyroWarmup(time_constant=effect.parameters["time_constant"])
    return BY_NAME[effect.name].initial_guesses()[0]


def _along(factors: Array, told: Callable[[float], tuple[float, str]]) -> tuple[Array, str]:
    """Return the share that is distinguished, (G,), and the strongest alternative at one half."""
    made = [told(float(factor)) for factor in factors[::2]]
    shares = np.maximum.accumulate([share for share, _ in made])
    rival = made[min(int(np.searchsorted(shares, 0.5)), len(made) - 1)][1]
    return np.interp(np.log(factors), np.log(factors[::2]), shares), rival


def _of_mean(seen: Seen, told: Callable[[float], tuple[float, str]]) -> Power:
    """Return the power by size of an effect in the mean."""
    freedom = seen.freedom

    def power(centre: Array, alarm: float) -> Array:
        if freedom == 1:
            return np.asarray(norm.sf(norm.isf(alarm) - np.sqrt(centre)))
        return np.asarray(ncx2.sf(ncx2.isf(alarm, freedom, 0.0), freedom, centre))

    grid = np.geomspace(1e-2, 300.0, 400)
    half = float(np.interp(0.5, power(grid, SHARED), grid))
    factors = SPREAD * np.sqrt(half / seen.centre)
    centre = factors**2 * seen.centre
    shares, rival = _along(factors, told)
    return Power(factors, power(centre, FALSE_ALARM), power(centre, SHARED), shares, rival, seen)


def _of_chance(setup: Setup, meter: Meter, effect: Effect) -> Power:
    """Return the power by size, from draws of the statistic with the effect."""

    def power(factor: float) -> tuple[float, float, float]:
        drawn, chosen = chance.statistic(
            setup, meter, scaled(effect, factor), np.random.default_rng(setup.seed)
        )
        there = [drawn > chance.threshold(drawn, one) for one in (FALSE_ALARM, SHARED)]
        return float(np.mean(there[0])), float(np.mean(there[1])), float(np.mean(there[1] & chosen))

    # Hits come in whole ones: nothing is smaller than the first.
    least = in_whole_hits(setup, effect, 0.0)
    low, high = max(least, 1e-2), 1e2
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if power(middle)[1] < 0.5 else (low, middle)
    factors = SPREAD[::2] * np.sqrt(low * high)
    factors = np.sort(np.append(factors[factors > 0.995 * least], 0.99 * least if least else []))
    made = [power(float(factor)) if factor > 0.995 * least else (0.0, 0.0, 0.0) for factor in factors]
    one, priced, told = np.maximum.accumulate(np.array(made), axis=0).T
    return Power(factors, one, priced, told, "its scope", least=least)
