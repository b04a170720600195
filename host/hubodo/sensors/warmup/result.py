"""What a record says about the warm-up of one gyro axis: the model that it bears, with sigmas that hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.effects.warmup import WARMUP_PARAMETERS, warmup_fraction
from hubodo.errors import InputError
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup.choice import Choice, choose
from hubodo.sensors.warmup.fit import WarmupFit
from hubodo.sensors.warmup.forecast import Forecast, forecast
from hubodo.sensors.warmup.judge import Judged

FloatArray = NDArray[np.float64]

HORIZON_S = 3.0 * 3600.0
"""How far beyond the record the sigmas of what is written hold."""
_UNITS = {"time_constant": "s", "time_constant_second": "s", "temperature_coefficient": "rad/s/°C"}


@dataclass(frozen=True)
class WarmupReport:
    """What a record says about the warm-up of one gyro axis.

    first: the exponential of the paper. reason: why its c1 and time constant are not given, "" when they are.
    following: the next model, None when the first is white or none is better. accepted: the model that the
    record bears, None where there is none. age: s since power-on at the first sample. t, means: (M,) the
    fitted means; grades: (M,) degrees C or None. record: gaps and outliers. notes: lines for people.
    """

    channel: str
    first: Judged
    reason: str
    following: Judged | None
    accepted: Judged | None
    age: float
    t: FloatArray
    means: FloatArray
    grades: FloatArray | None
    record: EvenGrid
    notes: tuple[str, ...]

    @cached_property
    def forecast(self) -> Forecast:
        """The bias at any age, over all forms that it may have."""
        span = float(self.t[-1] - self.t[0])
        found = (self.accepted or self.first).fit.values
        constants = [found[name] for name in ("time_constant", "time_constant_second") if name in found]
        begin = [min(max(constant, span / 50.0), 10.0 * span) for constant in constants]
        for other in (span / 4.0, span / 20.0):
            if len(begin) < 2 and all(abs(math.log(other / one)) > 0.5 for one in begin):
                begin.append(other)
        return forecast(self.t, self.means, self.grades, (*begin, span / 8.0)[:2])

    @cached_property
    def sigma(self) -> dict[str, float]:
        """1 sigma of the accepted model's parameters, with what its form may be wrong by.

        Such that what they alone make of the bias, up to `HORIZON_S` beyond the record, is at least as unsure
        as `forecast` has it: c2 takes on what the form is off by within the record, the c1 of the slower
        exponential what it is off by beyond. Empty without an accepted model.
        """
        if self.accepted is None:
            return {}
        fit, end = self.accepted.fit, float(self.t[-1])
        constants = {name: value for name, value in fit.values.items() if name.startswith("time_constant")}
        made = dict(fit.sigma)
        inside = self._form_variance(np.linspace(self.t[0], end, 9))
        made["c2"] = math.hypot(made["c2"], math.sqrt(float(inside.mean())))
        if not constants:
            return made
        slow = max(constants, key=lambda name: constants[name])
        later = end + HORIZON_S * np.linspace(0.0, 1.0, 7)
        grown = np.maximum(warmup_fraction(later, fit.values[slow]), 0.3)
        beyond = float(np.sqrt(np.max(self._form_variance(later) / grown**2)))
        name = slow.replace("time_constant", "c1")
        made[name] = math.hypot(made[name], beyond)
        return made

    def _form_variance(self, age: FloatArray) -> FloatArray:
        """(M,) (rad/s)² that the accepted model is off by beside what its parameters are."""
        assert self.accepted is not None
        fit = self.accepted.fit
        warm = None if self.grades is None else np.interp(age, self.t, self.grades)
        off = self.forecast.off(age, fit.model.bias(age, warm), warm)
        return np.maximum(off**2 - fit.spread(age, warm) ** 2, 0.0)

    @cached_property
    def choice(self) -> Choice | None:
        """How to go on from such a rest, beside the accepted model: by its mean or by a filter."""
        record = self.record
        t = np.asarray(self.age + np.arange(len(record.values)) * record.dt, np.float64)
        values = record.values
        if self.accepted is not None:
            warm = None if self.grades is None else np.asarray(np.interp(t, self.t, self.grades))
            values = values - self.accepted.fit.model.bias(t, warm)
        return choose(values[record.present], record.dt)

    def predicted(self, ages: Sequence[float] = ()) -> list[dict[str, float]]:
        """Bias, its sigma and what the accepted model says, at ages (s), else within and after the record."""
        t = np.asarray(ages, np.float64)
        if not len(t):
            begin, end = float(self.t[0]), float(self.t[-1])
            t = np.array([begin, 0.5 * (begin + end), end, end + 3600.0, end + HORIZON_S])
        warm = None if self.grades is None else np.interp(t, self.t, self.grades)
        bias, sigma = self.forecast.at(t, warm)
        rows = [
            {"age": float(x), "bias": float(y), "sigma": float(z)}
            for x, y, z in zip(t, bias, sigma, strict=True)
        ]
        if self.accepted is not None:
            told = self.accepted.fit.model.bias(t, warm)
            off = self.forecast.off(t, told, warm)
            for row, value, spread in zip(rows, told, off, strict=True):
                row |= {"accepted": float(value), "accepted_sigma": float(spread)}
        return rows

    def effects(self) -> dict[str, CalibratedEffect]:
        """Effects of the calibration file that the accepted model has, for this axis.

        Raises InputError without one.
        """
        axis = self.channel[1]
        if self.accepted is None:
            raise InputError(f"nothing to write to a calibration file: {self.reason}")
        fit = self.accepted.fit

        def quantity(name: str) -> Quantity:
            return Quantity(fit.values[name], self.sigma[name])

        method = f"warm-up at rest, {fit.kind}"
        made = {"gyro_bias": CalibratedEffect({axis: quantity("c2")}, method)}
        warm = {}
        for which in ("", "_second"):
            if f"c1{which}" in fit.values:
                warm[axis + which] = quantity(f"c1{which}")
                warm[f"time_constant{which}"] = quantity(f"time_constant{which}")
        if warm:
            made["gyro_warmup"] = CalibratedEffect(warm, method)
        if "temperature_coefficient" in fit.values:
            made["gyro_temperature"] = CalibratedEffect({axis: quantity("temperature_coefficient")}, method)
        return made

    def as_json(self, ages: Sequence[float] = ()) -> dict[str, Any]:
        """The fixed form that programs read, with additions beside it; ages: s, as of `predicted`.

        c1, c2 and the time constant are of the accepted model where it has one exponential, with the sigma
        that counts its form; without an accepted model c2 is that of the exponential.
        """
        fit = (self.accepted or self.first).fit
        sigma = self.sigma or fit.sigma
        single = self.accepted is not None and "c1" in fit.values and "c1_second" not in fit.values
        made: dict[str, Any] = {}
        for name in WARMUP_PARAMETERS["exponential"]:
            given = single or name == "c2"
            made[name] = {
                "value": fit.values[name] if given else None,
                "sigma": sigma[name] if given else None,
                "unit": _UNITS.get(name, "rad/s"),
            }
            if given and name != "time_constant":
                made[name] |= {"value_deg_per_s": math.degrees(fit.values[name])}
            if not given:
                made[name] |= {"reason": self.reason or see_next(fit)}
        return made | {
            "white": self.first.white,
            "whiteness": _tests(self.first),
            "next_model": None if self.following is None else _model(self.following),
            "accepted": None if self.accepted is None else fit.kind,
            "prediction": self.predicted(ages),
            "bias_filter": None if self.choice is None else asdict(self.choice),
            "channel": self.channel,
            "age_at_start": self.age,
            "duration": self.record.duration,
            "residual_noise": fit.noise,
            "notes": list(self.notes),
        }


def see_next(fit: WarmupFit) -> str:
    return f"a single exponential does not describe this record; see next model: {fit.kind}"


def _tests(judged: Judged) -> dict[str, Any]:
    test, box = judged.autocorrelation, judged.ljung_box
    return {
        "autocorrelation": {
            "white": test.white,
            "p_value": test.p_value,
            "sequences": test.sequences,
            "length": test.length,
            "standard_error": test.standard_error,
            "inside_one": test.inside_one,
            "inside_two": test.inside_two,
            "expected_one": test.expected_one,
            "expected_two": test.expected_two,
        },
        "ljung_box": {
            "white": box.white,
            "p_value": box.p_value,
            "statistic": box.statistic,
            "lags": box.lags,
        },
    }


def _model(judged: Judged) -> dict[str, Any]:
    fit = judged.fit
    parameters = {
        name: {"value": fit.values[name], "sigma": fit.sigma[name], "unit": _UNITS.get(name, "rad/s")}
        for name in WARMUP_PARAMETERS[fit.kind]
    }
    return {"kind": fit.kind, "parameters": parameters, "white": judged.white, "whiteness": _tests(judged)}
