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
from gap_matrix.world import Array
from hubodo.effects import BY_NAME
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
class Power:
    """How often an effect is seen in one drive.

    factors: (G,) times its typical size. one: (G,) share of logs in which a test of it alone sees it, with
    the false alarms of a whole log. priced: the same where all names in all scopes share these. centre:
    non-centrality at factor 1, freedom: coordinates that are seen; zero for what is of chance.
    """

    factors: Array
    one: Array
    priced: Array
    centre: float = 0.0
    freedom: int = 0

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
        powers[name] = _of_mean(*seen[name]) if name in seen else _of_chance(setup, meter, effect)
    return powers


def _nothing_hidden(setup: Setup) -> Point:
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write(setup, [], Path(folder), {})
        problem = build(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
    return refit_with_weights(initial_state(problem)).point


def informations(point: Point, hidden: Sequence[Effect]) -> dict[str, tuple[float, int]]:
    """By name: non-centrality at the typical size, and the coordinates that the drive shows at all."""
    warm = {
        effect.name: effect.parameters["time_constant"]
        for effect in hidden
        if "time_constant" in effect.parameters and effect.name == "gyro_warmup"
    }
    directions = all_directions(point.state)
    for constant in warm.values():
        seed = GyroWarmup(time_constant=constant)
        directions += [Direction(seed, node.name, k) for node in point.problem.nodes for k in range(3)]
    gram = linearise(point, directions).gram
    made = {}
    for effect in hidden:
        kind = BY_NAME[effect.name]
        true = kind(**effect.parameters)
        begin = GyroWarmup(time_constant=warm[effect.name]) if effect.name in warm else kind.seeds()[0]
        candidate = next(
            it
            for it in candidates(point.problem, directions)
            if it.term.effect == begin and it.term.scope == effect.scope
        )
        made[effect.name] = _information(gram, candidate, true.coordinates() - begin.coordinates())
    return made


def _information(gram: Array, candidate: Candidate, moved: Array) -> tuple[float, int]:
    count, freedom = len(candidate.basis), candidate.basis.shape[1]
    value = (moved / candidate.term.effect.coordinate_scales())[:freedom]
    inner = candidate.basis.T @ gram[:count, :count] @ candidate.basis
    seen = int(np.count_nonzero(np.linalg.eigvalsh(inner) > 1e-3))
    return float(value @ inner @ value), seen


def _of_mean(information: float, freedom: int) -> Power:
    """Power along the size. information: non-centrality at the typical one."""

    def power(centre: Array, alarm: float) -> Array:
        if freedom == 1:
            return np.asarray(norm.sf(norm.isf(alarm) - np.sqrt(centre)))
        return np.asarray(ncx2.sf(ncx2.isf(alarm, freedom, 0.0), freedom, centre))

    grid = np.geomspace(1e-2, 300.0, 400)
    half = float(np.interp(0.5, power(grid, SHARED), grid))
    factors = SPREAD * np.sqrt(half / information)
    centre = factors**2 * information
    return Power(factors, power(centre, FALSE_ALARM), power(centre, SHARED), information, freedom)


def _of_chance(setup: Setup, meter: Meter, effect: Effect) -> Power:
    """Power along the size, from draws of the statistic where the effect is there."""

    def power(factor: float) -> tuple[float, float]:
        drawn = chance.statistic(setup, meter, scaled(effect, factor), np.random.default_rng(setup.seed))
        return tuple(float(np.mean(drawn > chance.threshold(drawn, one))) for one in (FALSE_ALARM, SHARED))

    low, high = 1e-3, 1e3
    for _ in range(12):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if power(middle)[1] < 0.5 else (low, middle)
    factors = SPREAD[::2] * np.sqrt(low * high)
    both = np.maximum.accumulate(np.array([power(float(factor)) for factor in factors]), axis=0)
    return Power(factors, both[:, 0], both[:, 1])
