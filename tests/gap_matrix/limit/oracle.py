"""The oracle: detection limit of an effect in one drive if its name, scope and sign are known.

An effect on the mean is detected by the likelihood-ratio test of its coordinates with all nuisances refitted,
from the matrices with which `gap` screens. The statistic is a non-central chi square; its non-centrality is
the information about the effect times its squared size (Wald 1943). With one coordinate, the test is
one-sided. Random effects: see `chance.py`. An effect is identified if it is detected and its name and scope
are selected among all others (`choice.py`).
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
from gap_matrix.dose import GainMeter
from gap_matrix.effects import KINDS, SIDES, VEHICLE_EFFECTS, Effect, scale_effect
from gap_matrix.limit import chance, choice
from gap_matrix.limit.choice import NameOption, NameSelection
from gap_matrix.limit.trial import round_to_hits
from gap_matrix.world import Array
from hubodo.effects import BY_NAME
from hubodo.effects import Effect as HubodoEffect
from hubodo.effects.empirical import PREFIX, empirical_class
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

# Probability of a false alarm per log, the significance level of `gap`.
FALSE_ALARM = 0.01
# Number of names in scopes that share it (Bonferroni): left, right, all, or the vehicle.
N_CANDIDATES = sum(1 if name in VEHICLE_EFFECTS else len(SIDES) + 1 for name in KINDS)
SHARED_FALSE_ALARM = FALSE_ALARM / N_CANDIDATES
# Sizes at which the power is computed, relative to the size detected in half of the logs.
SIZE_GRID = np.exp(np.linspace(-1.6, 2.6, 43))
# Number of slowest modes of a random walk that may resemble another effect.
N_MODES = 12
WALK_NAME = "gyro_rate_random_walk"
# Typical intensity of the random walk, rad/s/√s, and the scale of its modes, rad/s.
TYPICAL_WALK_INTENSITY, MODE_SCALE = 5e-4, 0.01


@dataclass(frozen=True)
class MeanShift:
    """Test statistic of an effect on the mean at its typical size.

    noncentrality: non-centrality of the chi square
    dof: degrees of freedom: number of observable coordinates
    """

    noncentrality: float
    dof: int


@dataclass(frozen=True)
class Power:
    """Detection probability of an effect in one drive, by size.

    factors: (G,) multiples of the typical size
    detected_alone: (G,) detection probability of a test of this effect alone, at FALSE_ALARM per log
    detected: (G,) detection probability if all names in all scopes share FALSE_ALARM
    identified: (G,) probability of detection and selection of name and scope
    alternative: most frequent alternative at the size identified in half of the logs
    mean_shift: statistic of an effect on the mean, None for random effects
    min_factor: factor of a single hit, 0 for effects without hits
    """

    factors: Array
    detected_alone: Array
    detected: Array
    identified: Array
    alternative: str = ""
    mean_shift: MeanShift | None = None
    min_factor: float = 0.0

    @property
    def half_size(self) -> float:
        """Return the factor detected in half of the logs, with a shared false alarm."""
        return interpolate_half_size(self.factors, self.detected)


def interpolate_half_size(factors: Sequence[float] | Array, share: Sequence[float] | Array) -> float:
    """Return the factor at which an increasing share equals one half."""
    return float(np.exp(np.interp(0.5, share, np.log(factors))))


def compute_powers(setup: Setup, names: Sequence[str] = tuple(KINDS)) -> dict[str, Power]:
    """Return the powers by name in one drive; the parameters of the effects are drawn by its seed."""
    hidden = {name: cases.draw_hidden_effect(setup, name) for name in names}
    mean_effects = [effect for name, effect in hidden.items() if name not in chance.RANDOM_EFFECTS]
    walk = hidden.get(WALK_NAME)
    linear = _Linear(_evaluate_clean_drive(setup), mean_effects, setup.seed) if mean_effects or walk else None
    meter, powers = GainMeter(setup), dict[str, Power]()
    for name, effect in hidden.items():
        if name not in chance.RANDOM_EFFECTS and linear is not None:
            powers[name] = linear.power(effect)
            continue
        power = _compute_random_power(setup, meter, effect)
        powers[name] = (
            linear.power_of_walk(effect, power) if name == WALK_NAME and linear is not None else power
        )
    return powers


def _evaluate_clean_drive(setup: Setup) -> Evaluation:
    """Return the evaluation of the model on a drive without hidden effects."""
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write_case_files(setup, [], Path(folder), {})
        problem = build_problem(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
    return refit_with_weights(build_initial_state(problem)).evaluation


class _Linear:
    """A drive as a linear model: directions of effects on the mean, and slow modes of random walks."""

    def __init__(self, evaluation: Evaluation, hidden: Sequence[Effect], seed: int) -> None:
        nodes = [node.name for node in evaluation.problem.nodes]
        self._zero_effects = {effect.name: _build_zero_effect(effect) for effect in hidden}
        directions = list_directions(evaluation.state)
        for zero_effect in self._zero_effects.values():
            if isinstance(zero_effect, GyroWarmup):
                directions += [Direction(zero_effect, node, k) for node in nodes for k in range(3)]
        self._length = max(float(np.ptp(node.t)) for node in evaluation.problem.nodes)
        first_mode = len(directions)
        for node in nodes:
            for mode in range(N_MODES):
                effect = empirical_class(
                    f"{PREFIX}gx,gy,gz ~ cos(2*pi*{(mode + 0.5) / 2.0 / self._length:.6f}*t)"
                )()
                # Each channel has a cosine and a sine coordinate; the sine is used.
                directions += [Direction(effect, node, k) for k in (1, 3, 5)]
        gram = linearise(evaluation, directions).gram
        self._gram = gram[:-1, :-1]
        n_modes_per_node = N_MODES * 3
        self._mode_indices = {
            node: np.arange(first_mode + k * n_modes_per_node, first_mode + (k + 1) * n_modes_per_node)
            for k, node in enumerate(nodes)
        }
        self._mode_indices["all"] = np.arange(first_mode, len(directions))
        self._mean_candidates = [
            candidate
            for candidate in list_candidates(evaluation.problem, directions)
            if candidate.name in KINDS
        ]
        options = [
            NameOption(
                candidate.name, candidate.term.scope, candidate.basis, np.ones(candidate.basis.shape[1])
            )
            for candidate in self._mean_candidates
        ]
        options += [
            NameOption(
                WALK_NAME,
                scope,
                np.eye(len(directions))[:, indices],
                self._compute_mode_sigmas(TYPICAL_WALK_INTENSITY, len(indices)),
            )
            for scope, indices in self._mode_indices.items()
        ]
        self._selection = NameSelection(self._gram, options, np.random.default_rng((seed, 30)))

    def _compute_mode_sigmas(self, k: float, count: int) -> Array:
        """Return 1 sigma (count,) of the modes of a random walk (Karhunen-Loève), three axes per mode."""
        mode = np.repeat(np.arange(N_MODES) + 0.5, 3)
        return np.resize(k * np.sqrt(2.0 * self._length) / (np.pi * mode) / MODE_SCALE, count)

    def power(self, effect: Effect) -> Power:
        """Return the power of an effect on the mean, by size."""
        zero_effect = self._zero_effects[effect.name]
        candidate = next(
            candidate
            for candidate in self._mean_candidates
            if (candidate.term.effect, candidate.term.scope) == (zero_effect, effect.scope)
        )
        change = BY_NAME[effect.name](**effect.parameters).coordinates() - zero_effect.coordinates()
        coordinates = (change / zero_effect.coordinate_scales())[: candidate.basis.shape[1]]
        direction = candidate.basis @ coordinates
        information = candidate.basis.T @ self._gram @ candidate.basis
        noncentrality = float(direction @ self._gram @ direction)
        mean_shift = MeanShift(noncentrality, int(np.count_nonzero(np.linalg.eigvalsh(information) > 1e-3)))

        def identify(factor: float) -> tuple[float, str]:
            is_selected, alternative = self._selection.select(direction, factor, effect.name, effect.scope)
            scores = self._selection.scores(factor * direction)
            is_detected = choice.is_detected(
                scores, self._gram, candidate.basis, coordinates, SHARED_FALSE_ALARM
            )
            return float(np.mean(is_selected & is_detected)), alternative

        return _compute_mean_power(mean_shift, identify)

    def power_of_walk(self, effect: Effect, power: Power) -> Power:
        """Return the power of a random walk with its probability of identification, by draws of its modes."""
        indices, rng = self._mode_indices[effect.scope], np.random.default_rng((len(self._gram), 31))
        direction = np.zeros((choice.N_DRAWS, len(self._gram)))
        sigmas = self._compute_mode_sigmas(effect.parameters["k"], len(indices))
        direction[:, indices] = sigmas * rng.standard_normal((choice.N_DRAWS, len(indices)))

        def identify(factor: float) -> tuple[float, str]:
            is_selected, alternative = self._selection.select(direction, factor, WALK_NAME, effect.scope)
            eigenvalues, axes = np.linalg.eigh(
                (self._gram[np.ix_(indices, indices)] * sigmas).T * sigmas * factor**2
            )
            eigenvalues = np.maximum(eigenvalues, 0.0)
            scores = self._selection.scores(factor * direction)[:, indices] * sigmas * factor
            statistics = 0.5 * (
                (scores @ axes) ** 2 @ (1.0 / (1.0 + eigenvalues)) - np.sum(np.log1p(eigenvalues))
            )
            return float(
                np.mean(
                    is_selected & (statistics > chance.detection_threshold(statistics, SHARED_FALSE_ALARM))
                )
            ), alternative

        identified_shares, alternative = _identify_by_size(power.factors, identify)
        return replace(power, identified=identified_shares, alternative=alternative)


def _build_zero_effect(effect: Effect) -> HubodoEffect:
    """Return the effect of the package at zero size, with its known parameters."""
    if effect.name == "gyro_warmup":
        return GyroWarmup(time_constant=effect.parameters["time_constant"])
    return BY_NAME[effect.name].initial_guesses()[0]


def _identify_by_size(factors: Array, identify: Callable[[float], tuple[float, str]]) -> tuple[Array, str]:
    """Return the probability of identification, (G,), and the strongest alternative at one half."""
    results = [identify(float(factor)) for factor in factors[::2]]
    identified_shares = np.maximum.accumulate([share for share, _ in results])
    alternative = results[min(int(np.searchsorted(identified_shares, 0.5)), len(results) - 1)][1]
    return np.interp(np.log(factors), np.log(factors[::2]), identified_shares), alternative


def _compute_mean_power(mean_shift: MeanShift, identify: Callable[[float], tuple[float, str]]) -> Power:
    """Return the power by size of an effect on the mean."""
    dof = mean_shift.dof

    def power(noncentrality: Array, false_alarm: float) -> Array:
        if dof == 1:
            return np.asarray(norm.sf(norm.isf(false_alarm) - np.sqrt(noncentrality)))
        return np.asarray(ncx2.sf(ncx2.isf(false_alarm, dof, 0.0), dof, noncentrality))

    grid = np.geomspace(1e-2, 300.0, 400)
    half_noncentrality = float(np.interp(0.5, power(grid, SHARED_FALSE_ALARM), grid))
    factors = SIZE_GRID * np.sqrt(half_noncentrality / mean_shift.noncentrality)
    noncentrality = factors**2 * mean_shift.noncentrality
    identified_shares, alternative = _identify_by_size(factors, identify)
    return Power(
        factors,
        power(noncentrality, FALSE_ALARM),
        power(noncentrality, SHARED_FALSE_ALARM),
        identified_shares,
        alternative,
        mean_shift,
    )


def _compute_random_power(setup: Setup, meter: GainMeter, effect: Effect) -> Power:
    """Return the power by size of a random effect, from draws of its statistic."""

    def power(factor: float) -> tuple[float, float, float]:
        statistics, is_selected = chance.draw_statistic(
            setup, meter, scale_effect(effect, factor), np.random.default_rng(setup.seed)
        )
        is_detected = [
            statistics > chance.detection_threshold(statistics, false_alarm)
            for false_alarm in (FALSE_ALARM, SHARED_FALSE_ALARM)
        ]
        return (
            float(np.mean(is_detected[0])),
            float(np.mean(is_detected[1])),
            float(np.mean(is_detected[1] & is_selected)),
        )

    # The smallest possible effect is a single hit.
    min_factor = round_to_hits(setup, effect, 0.0)
    low, high = max(min_factor, 1e-2), 1e2
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if power(middle)[1] < 0.5 else (low, middle)
    factors = SIZE_GRID[::2] * np.sqrt(low * high)
    factors = np.sort(
        np.append(factors[factors > 0.995 * min_factor], 0.99 * min_factor if min_factor else [])
    )
    results = [power(float(factor)) if factor > 0.995 * min_factor else (0.0, 0.0, 0.0) for factor in factors]
    detected_alone, detected, identified = np.maximum.accumulate(np.array(results), axis=0).T
    return Power(factors, detected_alone, detected, identified, "its scope", min_factor=min_factor)
