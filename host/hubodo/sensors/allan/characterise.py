"""Noise analysis of one stationary channel: Allan deviation, noise terms, best averaging time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.allan.covariance import TERMS, covariance_tensor, design_matrix
from hubodo.sensors.allan.deviation import AllanPoints, allan_deviation, averaging_factors
from hubodo.sensors.allan.fit import NoiseFit, NoiseTerm, fit_noise
from hubodo.sensors.allan.ieee952 import is_gyro
from hubodo.sensors.allan.noise_change import find_noise_change
from hubodo.sensors.allan.result import AllanResult
from hubodo.sensors.allan.sinusoids import Sinusoid, remove_sinusoids
from hubodo.sensors.bias_step import find_bias_step
from hubodo.sensors.code_density import count_codes, missing_codes, uneven_steps
from hubodo.sensors.even_grid import EvenGrid, Spans, grid_all_samples, place_on_grid
from hubodo.sensors.imu.quantisation import rounding_sigma
from hubodo.sensors.standstill_channel import StandstillRecord
from hubodo.sensors.standstill_checks import TemperatureStep

# With fewer samples the error bars of neighbouring octaves overlap.
_MIN_SAMPLES = 256
_COARSE_STEP_RATIO, _BLIND_STEP_RATIO = 1.8, 5.0
"""Steps in units of the scatter of the samples. Noise of half a step scatters by 1 / 1.73 of a step; with
less, the error of a mean no longer averages out, and it is not white.
"""
_MAX_UNEVENNESS = 0.15
"""Differential nonlinearity, relative, from which on the noise at the output is not that of the sensor."""
_MAX_PLAUSIBLE_RANDOM_WALK = math.radians(10.0 / 60.0)
"""rad/√s, 10 deg/√h; gyros of the 1990s had 5, the MEMS gyros of today have 0.1 to 1."""


def characterise_standstill_noise(
    standstill: StandstillRecord, *, turn: float = 2.0, per_octave: int = 1, keep_all_samples: bool = False
) -> AllanResult:
    """Compute the Allan deviation of a checked channel, as `characterise_noise`; errors name the log."""
    try:
        return characterise_noise(
            standstill.t,
            standstill.values,
            standstill.channel,
            turn=turn,
            per_octave=per_octave,
            temperature_step=standstill.temperature_step,
            excluded=standstill.disturbances,
            keep_all_samples=keep_all_samples,
            node=standstill.node,
        )
    except InputError as error:
        raise InputError(f"{standstill.source}: {error}") from None


def characterise_noise(
    t: Array,
    values: Array,
    channel: str,
    *,
    turn: float = 2.0,
    per_octave: int = 1,
    temperature_step: TemperatureStep | None = None,
    excluded: Spans = (),
    keep_all_samples: bool = False,
    node: str = "",
) -> AllanResult:
    """Compute the Allan deviation and the noise terms of one channel of a stationary sensor.

    t: (N,) s, strictly increasing. values: (N,) rad/s or m/s². turn: time that a maytagging table needs from
    stop to stop, s. per_octave: averaging times per octave. temperature_step: a temperature step in the
    record, if any; B, K and R are then not given, because they would measure the room. excluded: (start, end)
    of disturbances in s, treated as gaps. keep_all_samples: use every sample and assume no gaps, outliers or
    disturbances (the plain deviation). node: name of the node. Raises InputError if the record is too short,
    constant or not finite.
    """
    record = grid_all_samples(t, values) if keep_all_samples else place_on_grid(t, values, excluded=excluded)
    count = len(record.values)
    if count < _MIN_SAMPLES:
        raise InputError(
            f"{count} samples ({record.duration:.3g} s) are too few for an Allan deviation with error bars; "
            f"record at least {_MIN_SAMPLES} samples, and some hours for bias instability"
        )
    # Steps that hide the noise are refused before the fit, whose deviations may be zero.
    coarse = _describe_coarse_steps(values, channel)
    sinusoids: tuple[Sinusoid, ...] = ()
    if not keep_all_samples:
        record, sinusoids = remove_sinusoids(record)
    present = None if record.missing == 0 else record.present
    factors = averaging_factors(count, per_octave)
    points = allan_deviation(record.values, record.dt, factors, present)
    slope = record.slope()

    def detrended_points() -> AllanPoints:
        detrended = record.values - slope * record.dt * np.arange(count)
        return allan_deviation(detrended, record.dt, points.factors, present)

    fit = fit_noise(points, slope, detrended_points)
    cause = _cause_of_step(record, temperature_step, channel)
    if cause:
        fit = _without_terms(fit, cause, ("B", "K", "R"), "slow terms would measure that step")
    if coarse:
        fit = _without_terms(fit, coarse, TERMS, "the deviation is that of the rounding, not of the sensor")
    elif change := _describe_noise_change(record, channel):
        fit = _without_terms(fit, change, TERMS, "one number does not describe both parts")
        cause = f"{cause}, and {change}" if cause else change
    edf = _equivalent_dof(points, fit)
    low = points.adev * np.sqrt(edf / chdtri(edf, 0.025))
    high = points.adev * np.sqrt(edf / chdtri(edf, 0.975))
    best_tau, best_deviation = _find_minimum(points, fit, edf)
    notes = (
        *_describe_sinusoids(sinusoids, channel),
        *_write_notes(channel, record, points, fit, cause, coarse, still_falling=best_tau is None),
    )
    stop = None if cause else _optimal_maytag_stop(fit, turn, points)
    sigma = points.adev / np.sqrt(2.0 * edf)
    return AllanResult(
        channel, points, edf, sigma, low, high, fit, best_tau, best_deviation, stop, turn, record, notes,
        node, sinusoids=sinusoids,
    )  # fmt: skip


def _describe_sinusoids(sinusoids: Sequence[Sinusoid], channel: str) -> list[str]:
    """Return a remark on the lines that were removed."""
    if not sinusoids:
        return []
    lines = ", ".join(
        f"{it.frequency:.5g} Hz with {_in_common_unit(it.amplitude, channel)}" for it in sinusoids
    )
    return [
        f"sinusoids removed: {lines} (amplitude), as of vibration or mains; the noise terms are those beside "
        "them, and --as-is keeps them"
    ]


def _write_notes(
    channel: str,
    record: EvenGrid,
    points: AllanPoints,
    fit: NoiseFit,
    cause: str,
    coarse: str,
    *,
    still_falling: bool,
) -> tuple[str, ...]:
    """Return remarks for the user.

    cause: step that hides slow terms, or "". coarse: steps that hide all terms, or "". still_falling: True if
    the deviation falls up to the end.
    """
    notes = list(record.notes)
    if record.excluded:
        cut_duration = sum(end - start for start, end in record.excluded)
        first, last = record.excluded[0]
        notes.append(
            f"the sensor was disturbed or frozen in {_count_stretches(len(record.excluded))}, "
            f"{cut_duration:.3g} s in total, first from {first:.6g} to {last:.6g} s: cut out and treated "
            "as gaps; --as-is keeps them"
        )
    if cause:
        has_white_noise = fit.terms["N"].value is not None
        notes.append(f"{cause}: {'B, K and R are not' if has_white_noise else 'no noise term is'} given")
    if coarse:
        notes.append(f"{coarse}: no noise term is given; use a smaller range, or record more bits or digits")
    random_walk = fit.terms["N"].value
    if is_gyro(channel) and random_walk is not None and random_walk > _MAX_PLAUSIBLE_RANDOM_WALK:
        notes.append(
            f"an angle random walk of {math.degrees(random_walk) * 60.0:.3g} deg/√h is far beyond MEMS gyros "
            "(0.1 to 5): data in deg/s that are read as rad/s are 57 times too large; check --unit"
        )
    if fit.markov is not None:
        notes.append(
            f"noise of {_in_common_unit(fit.markov.sigma, channel)} (1σ) is correlated over "
            f"{fit.markov.time:.3g} s, a first-order Gauss-Markov process beside the terms"
        )
    if fit.factors[0] > 1:
        notes.append(
            f"averaging times below {fit.factors[0] * points.dt:.3g} s are excluded from the fit: they are "
            "dominated by the sensor's bandwidth or a vibration; its effect on longer ones is corrected"
        )
    if fit.misfit > 0:
        notes.append(
            f"the five terms do not fit within the error bars: the model error is {fit.misfit:.1%} "
            f"(chi-square {fit.chi2:.3g} for {fit.dof} degrees of freedom); the sigmas include it"
        )
    if still_falling:
        notes.append(
            f"the deviation still falls at the end of the record: the best averaging time is longer than "
            f"{points.samples * points.dt / 6:.3g} s; a longer record would show it"
        )
    return tuple(notes)


def _equivalent_dof(points: AllanPoints, fit: NoiseFit) -> Array:
    """Return the (P,) equivalent degrees of freedom, 2 mean^2 / variance, for the fitted noise terms."""
    variance = np.empty(len(points.factors))
    for k, factor in enumerate(points.factors):
        tensor = covariance_tensor(np.array([factor]), points.samples, points.dt)[0, 0]
        variance[k] = fit.theta @ tensor @ fit.theta
    pair_ratio = (points.samples - 2 * points.factors + 1) / points.pairs
    # A low-pass reduces mean and variance alike and does not change the degrees of freedom.
    plain = design_matrix(points.tau) @ fit.theta
    edf: Array = np.maximum(2.0 * plain**2 / (variance * pair_ratio), 1.0)
    return edf


def _find_minimum(points: AllanPoints, fit: NoiseFit, edf: Array) -> tuple[float | None, float | None]:
    """Return averaging time and value of the smallest fitted deviation, or None if it falls to the end."""
    rising = [name for name in ("B", "K", "R") if fit.terms[name].value is not None]
    if not rising:
        return None, None
    longest = float(points.tau[np.flatnonzero(edf >= 3.0)[-1]])
    tau = np.geomspace(points.tau[0], longest, 2000)
    variance = fit.variance(tau)
    # With flicker noise alone the deviation levels off without a minimum; averaging stops paying where it is
    # within 5 % of the floor.
    index = int(np.argmax(variance <= 1.1 * variance.min())) if rising == ["B"] else int(np.argmin(variance))
    if index == len(tau) - 1:
        return None, None
    return float(tau[index]), float(np.sqrt(variance[index]))


def _optimal_maytag_stop(fit: NoiseFit, turn: float, points: AllanPoints) -> float | None:
    """Return the stop length, s, that minimises the error of maytagging in a given total time.

    Half the difference of two adjacent stops has half the Allan variance, and a pair takes 2 (tau + turn).
    The mean over a fixed time therefore has a variance proportional to sigma^2(tau) (tau + turn): shorter
    stops reduce drift, longer ones spend less time on turns.
    """
    if all(fit.terms[name].value is None for name in ("B", "K", "R")):
        return None
    tau = np.geomspace(max(points.tau[0], turn / 10.0), points.samples * points.dt, 4000)
    return float(tau[int(np.argmin(fit.variance(tau) * (tau + turn)))])


def _cause_of_step(record: EvenGrid, temperature_step: TemperatureStep | None, channel: str) -> str:
    """Return a step of the temperature or the bias in words, or "" if the record has none."""
    if temperature_step is not None:
        return f"the temperature steps by {temperature_step.change:+.2f} °C at {temperature_step.t:.6g} s"
    t = np.asarray(record.start + np.flatnonzero(record.present) * record.dt, np.float64)
    step = find_bias_step(t, record.values[record.present])
    if step is None:
        return ""
    return f"the bias steps by {_in_common_unit(step.change, channel, '+.3g')} at {step.t:.6g} s"


def _describe_noise_change(record: EvenGrid, channel: str) -> str:
    """Return in words that the white noise of the record changes, or "" if it does not."""
    change = find_noise_change(record)
    if change is None:
        return ""
    t, before, after = change
    return (
        f"the scatter of the samples changes from {_in_common_unit(before, channel)} to "
        f"{_in_common_unit(after, channel)} at about {t:.6g} s, as with another sensor, range or bandwidth: "
        f"use --end {t:.6g} or --start {t:.6g}"
    )


def _describe_coarse_steps(values: Array, channel: str) -> str:
    """Return in words that the channel is rounded to steps larger than its noise, or "" if it is not.

    Raises InputError for steps that hide the noise altogether.
    """
    step = rounding_sigma(values)[1]
    ratio = step / max(float(np.std(np.diff(values))) / math.sqrt(2.0), 1e-300)
    counts = count_codes(values, step)
    missing, expected = missing_codes(counts)
    if missing:
        return (
            f"{missing} of {expected} codes of the converter never occur, so that its steps of "
            f"{_in_common_unit(step, channel)} are uneven"
        )
    if (unevenness := uneven_steps(counts)) > _MAX_UNEVENNESS:
        return f"the steps of {_in_common_unit(step, channel)} are uneven by {unevenness:.0%} (1σ)"
    if ratio < _COARSE_STEP_RATIO:
        return ""
    text = f"the output has steps of {_in_common_unit(step, channel)}, {ratio:.1f} times the samples' scatter"
    if ratio > _BLIND_STEP_RATIO:
        raise InputError(
            f"{text}: the noise of the sensor does not show; use a smaller range, or more bits or digits"
        )
    return text


def _in_common_unit(value: float, channel: str, form: str = ".3g") -> str:
    return f"{math.degrees(value):{form}} deg/s" if is_gyro(channel) else f"{value:{form}} m/s²"


def _without_terms(fit: NoiseFit, cause: str, names: Sequence[str], effect: str) -> NoiseFit:
    """Return the fit with some terms marked as not shown, because of a step or of coarse rounding."""
    reason = f"{cause}: {effect}"
    terms = {
        name: NoiseTerm(None, None, reason) if name in names else term for name, term in fit.terms.items()
    }
    return replace(fit, terms={name: terms[name] for name in TERMS})


def _count_stretches(count: int) -> str:
    return "one stretch" if count == 1 else f"{count} stretches"
