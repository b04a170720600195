"""The whole characterisation of one channel at rest: Allan deviation, noise terms, best averaging time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from hubodo.errors import InputError
from hubodo.sensors.allan.covariance import TERMS, covariance_tensor, design
from hubodo.sensors.allan.deviation import AllanPoints, allan_deviation, averaging_factors
from hubodo.sensors.allan.fit import NoiseFit, NoiseTerm, fit_noise
from hubodo.sensors.allan.ieee952 import rate_unit, units
from hubodo.sensors.at_rest import TemperatureStep
from hubodo.sensors.even_grid import EvenGrid, Spans, as_is, even_grid

FloatArray = NDArray[np.float64]

# Fewer samples leave no octave with its error bar apart from the next.
_FEWEST_SAMPLES = 256


@dataclass(frozen=True)
class AllanReport:
    """What one channel is worth.

    points: the deviation. edf: (P,) equivalent degrees of freedom; sigma: (P,) 1 sigma of the deviation; low,
    high: (P,) 95 % interval by chi-square. fit: the terms. best_tau: averaging time in s with the smallest
    deviation, None when the record is too short to show a minimum. stop, turn: recommended length of a maytag
    stop and the turn between stops it was computed for, s. record: gaps, outliers, interval. notes: lines for
    people.
    """

    channel: str
    points: AllanPoints
    edf: FloatArray
    sigma: FloatArray
    low: FloatArray
    high: FloatArray
    fit: NoiseFit
    best_tau: float | None
    best_deviation: float | None
    stop: float | None
    turn: float
    record: EvenGrid
    notes: tuple[str, ...] = field(default=())

    def as_json(self) -> dict[str, Any]:
        """The fixed form that programs read, with additions beside it."""
        names = units(self.channel)
        coefficients = {}
        for name, term in self.fit.terms.items():
            unit = names[name]
            coefficients[name] = {
                "value": term.value,
                "sigma": term.sigma,
                "unit": unit.si,
                "name": unit.name,
                f"value_{_key(unit.customary)}": None if term.value is None else term.value * unit.factor,
            }
            if term.value is None:
                coefficients[name] |= {
                    "reason": term.reason,
                    "limit_95": term.limit,
                    "record_needed_s": term.needed,
                }
            else:
                coefficients[name] |= {"low_95": term.low, "high_95": term.high}
        return {
            "tau": self.points.tau.tolist(),
            "adev": self.points.adev.tolist(),
            "sigma": self.sigma.tolist(),
            "low_95": self.low.tolist(),
            "high_95": self.high.tolist(),
            "edf": self.edf.tolist(),
            "coefficients": coefficients,
            "unit": rate_unit(self.channel).si,
            "channel": self.channel,
            "optimum_averaging_time": self.best_tau,
            "smallest_deviation": self.best_deviation,
            "maytag": {"stop": self.stop, "turn": self.turn},
            "fit": {
                "chi2": self.fit.chi2,
                "dof": self.fit.dof,
                "relative_misfit": self.fit.misfit,
                "tau": (self.fit.factors * self.points.dt).tolist(),
                "band": self.fit.band,
            },
            "record": {
                "samples": int(np.count_nonzero(self.record.present)),
                "interval": self.record.dt,
                "duration": self.record.duration,
                "gaps": [{"t": t, "missing": missing} for t, missing in self.record.gaps],
                "outliers": self.record.outliers.tolist(),
                "jitter_intervals": None if np.isnan(self.record.jitter) else self.record.jitter,
            },
            "excluded": [{"start": begin, "end": end} for begin, end in self.record.excluded],
            "notes": list(self.notes),
        }


def characterise(
    t: FloatArray,
    values: FloatArray,
    channel: str,
    *,
    turn: float = 2.0,
    per_octave: int = 1,
    step: TemperatureStep | None = None,
    excluded: Spans = (),
    every_sample: bool = False,
) -> AllanReport:
    """Allan deviation and noise terms of one channel of a sensor at rest.

    t: (N,) s, strictly increasing; values: (N,) rad/s or m/s². turn: time a maytag table needs from stop to
    stop, s. per_octave: averaging times per octave. step: a temperature step in the record; the slow terms
    then measure the room and are not given. excluded: (from, to) in s, disturbed, treated as gaps.
    every_sample: no gap, outlier or disturbance is looked for: the plain deviation. Raises InputError when
    the record is too short, constant or not finite.
    """
    record = as_is(t, values) if every_sample else even_grid(t, values, excluded=excluded)
    count = len(record.values)
    if count < _FEWEST_SAMPLES:
        raise InputError(
            f"{count} samples ({record.duration:.3g} s) are too few for an Allan deviation with error bars; "
            f"record at least {_FEWEST_SAMPLES} samples, and some hours for bias instability"
        )
    present = None if record.missing == 0 else record.present
    factors = averaging_factors(count, per_octave)
    points = allan_deviation(record.values, record.dt, factors, present)
    slope = record.slope()

    def level() -> AllanPoints:
        rest = record.values - slope * record.dt * np.arange(count)
        return allan_deviation(rest, record.dt, points.factors, present)

    fit = fit_noise(points, slope, level)
    if step is not None:
        fit = _without_slow_terms(fit, step)
    edf = _edf(points, fit)
    low = points.adev * np.sqrt(edf / chdtri(edf, 0.025))
    high = points.adev * np.sqrt(edf / chdtri(edf, 0.975))
    best_tau, best = _minimum(points, fit, edf)
    notes = _notes(record, points, fit, step, falls=best_tau is None)
    stop = None if step is not None else _stop(fit, turn, points)
    sigma = points.adev / np.sqrt(2.0 * edf)
    return AllanReport(channel, points, edf, sigma, low, high, fit, best_tau, best, stop, turn, record, notes)


def _notes(
    record: EvenGrid, points: AllanPoints, fit: NoiseFit, step: TemperatureStep | None, *, falls: bool
) -> tuple[str, ...]:
    """What people have to know beside the numbers. falls: the deviation does so to the end."""
    notes = list(record.notes)
    if record.excluded:
        cut = sum(end - begin for begin, end in record.excluded)
        first, last = record.excluded[0]
        notes.append(
            f"the sensor was disturbed in {_times(len(record.excluded), 'stretch')}, {cut:.3g} s in all, the "
            f"first from {first:.6g} to {last:.6g} s: cut out and treated as gaps; --as-is takes them in"
        )
    if step is not None:
        notes.append(
            f"temperature steps by {step.change:+.2f} °C at {step.t:.6g} s: B, K and R are not given"
        )
    if fit.factors[0] > 1:
        notes.append(
            f"averaging times below {fit.factors[0] * points.dt:.3g} s are not in the fit: they follow the "
            "sensor's bandwidth or a vibration, which the longer ones are corrected for"
        )
    if fit.misfit > 0:
        notes.append(
            f"the five terms describe the variance to {fit.misfit:.1%} beyond its error bars (chi-square "
            f"{fit.chi2:.3g} for {fit.dof} degrees of freedom); the sigmas are widened by that"
        )
    if falls:
        notes.append(
            f"the deviation still falls at the end of the record: the best averaging time is longer than "
            f"{points.samples * points.dt / 6:.3g} s; record for longer to see it"
        )
    return tuple(notes)


def _edf(points: AllanPoints, fit: NoiseFit) -> FloatArray:
    """(P,) 2 mean^2 / variance of each estimate, for the fitted mixture of noises."""
    variance = np.empty(len(points.factors))
    for k, factor in enumerate(points.factors):
        tensor = covariance_tensor(np.array([factor]), points.samples, points.dt)[0, 0]
        variance[k] = fit.theta @ tensor @ fit.theta
    lost = (points.samples - 2 * points.factors + 1) / points.pairs
    # A low-pass makes the variance less, and leaves the degrees of freedom what they are.
    plain = design(points.tau) @ fit.theta
    made: FloatArray = np.maximum(2.0 * plain**2 / (variance * lost), 1.0)
    return made


def _minimum(points: AllanPoints, fit: NoiseFit, edf: FloatArray) -> tuple[float | None, float | None]:
    """Averaging time and value of the smallest fitted deviation.

    None when nothing rises or levels off after it.
    """
    rising = [name for name in ("B", "K", "R") if fit.terms[name].value is not None]
    if not rising:
        return None, None
    longest = float(points.tau[np.flatnonzero(edf >= 3.0)[-1]])
    tau = np.geomspace(points.tau[0], longest, 2000)
    variance = fit.variance(tau)
    # Flicker alone levels off without a minimum: longer than where 5 % is left to gain, nobody needs to
    # average.
    place = int(np.argmax(variance <= 1.1 * variance.min())) if rising == ["B"] else int(np.argmin(variance))
    if place == len(tau) - 1:
        return None, None
    return float(tau[place]), float(np.sqrt(variance[place]))


def _stop(fit: NoiseFit, turn: float, points: AllanPoints) -> float | None:
    """Stop length for which maytagging for a given total time ends with the smallest error.

    Half the difference of two adjacent stops has half the Allan variance; a pair costs 2 (tau + turn). So the
    mean over a fixed time has a variance proportional to sigma^2(tau) (tau + turn): shorter stops let less
    drift in, longer ones waste less time on turns.
    """
    if all(fit.terms[name].value is None for name in ("B", "K", "R")):
        return None
    tau = np.geomspace(max(points.tau[0], turn / 10.0), points.samples * points.dt, 4000)
    return float(tau[int(np.argmin(fit.variance(tau) * (tau + turn)))])


def _without_slow_terms(fit: NoiseFit, step: TemperatureStep) -> NoiseFit:
    reason = (
        f"the temperature steps by {step.change:+.2f} °C at {step.t:.6g} s: slow terms measure the room, "
        "not the "
        "sensor; record at constant temperature, or take a part with --start and --end"
    )
    slow = ("B", "K", "R")
    terms = {
        name: NoiseTerm(None, None, reason) if name in slow else term for name, term in fit.terms.items()
    }
    return replace(fit, terms={name: terms[name] for name in TERMS})


def _times(count: int, thing: str) -> str:
    return f"one {thing}" if count == 1 else f"{count} {thing}es"


def _key(unit: str) -> str:
    """A unit as part of a JSON key: deg/√h becomes deg_per_sqrt_h."""
    return unit.replace("/√", "_per_sqrt_").replace("/", "_per_").replace("µ", "micro_").replace("²", "2")
