"""Judging a warm-up model by the whiteness of its residual, and choosing the next one by the same test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.effects.warmup import WARMUP_PARAMETERS, WarmupKind
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup.fit import WarmupFit, fit_warmup
from hubodo.sensors.warmup.whiteness import AutocorrelationTest, LjungBox, autocorrelation_test, ljung_box

FloatArray = NDArray[np.float64]

# The paper's sequences: ten of 10 s each.
_SEQUENCES, _SEQUENCE_S, _LONGEST_SEQUENCE = 10, 10.0, 2000
_TEMPERATURE_SPAN = 1.0


@dataclass(frozen=True)
class Judged:
    """A fitted model and what the tests say of its residual."""

    fit: WarmupFit
    autocorrelation: AutocorrelationTest
    ljung_box: LjungBox

    @property
    def white(self) -> bool:
        """Both tests pass: the samples within seconds, the means over the whole record."""
        return self.autocorrelation.white and self.ljung_box.white


def judge(fit: WarmupFit, record: EvenGrid, age: float, temperature: FloatArray | None) -> Judged:
    """Whiteness of the samples in short sequences, and of the means over the whole record."""
    length = int(np.clip(round(_SEQUENCE_S / record.dt), 200, _LONGEST_SEQUENCE))
    length = min(length, len(record.values))
    sequences = max(1, min(_SEQUENCES, len(record.values) // length))
    parts = []
    for start in np.linspace(0, len(record.values) - length, sequences).astype(int):
        part = slice(int(start), int(start) + length)
        t = np.asarray(age + np.arange(part.start, part.stop) * record.dt, np.float64)
        rest = record.values[part] - fit.model.bias(t, None if temperature is None else temperature[part])
        parts.append(np.where(record.present[part], rest, 0.0))
    samples = np.concatenate(parts)
    return Judged(fit, autocorrelation_test(samples, sequences, length), ljung_box(fit.residual))


def next_model(
    first: Judged,
    times: FloatArray,
    means: FloatArray,
    grades: FloatArray | None,
    record: EvenGrid,
    t: FloatArray,
    temperature: FloatArray | None,
    age: float,
) -> Judged | None:
    """The next model by the same test: the first white one, else the least coloured one if clearly better."""
    kinds: list[WarmupKind] = ["two exponentials"]
    filled = None
    if grades is not None and temperature is not None and float(np.ptp(grades)) > _TEMPERATURE_SPAN:
        kinds = ["temperature", "exponential and temperature", *kinds]
        filled = np.interp(record.start + np.arange(len(record.values)) * record.dt, t, temperature)
    judged = []
    for kind in kinds:
        warm = "temperature_coefficient" in WARMUP_PARAMETERS[kind]
        fit = fit_warmup(times, means, kind, grades if warm else None)
        # What the record does not determine is no model, however well it fits.
        if fit.determined and fit.bic < first.fit.bic - 10.0:
            judged.append(judge(fit, record, age, filled if warm else None))
    white = [model for model in judged if model.ljung_box.white]
    if white:
        return min(white, key=lambda model: model.fit.bic)
    better = [model for model in judged if model.ljung_box.statistic < 0.8 * first.ljung_box.statistic]
    return min(better, key=lambda model: model.ljung_box.statistic, default=None)


def verdict(first: Judged, following: Judged | None) -> str:
    box = first.ljung_box
    test = f"Ljung-Box {box.statistic:.3g} over {box.lags} lags, p = {box.p_value:.2g}"
    if following is None:
        return (
            f"the residual of the exponential is not white ({test}) and no next model is clearly better: "
            "what remains is bias instability or random walk, see hubodo allan; the sigmas are widened by it"
        )
    then = "white" if following.ljung_box.white else "still not white, but less so"
    return (
        f"the residual of the exponential is not white ({test}); next model: {following.fit.kind}, whose "
        "residual is "
        f"{then} (Ljung-Box {following.ljung_box.statistic:.3g}, p = {following.ljung_box.p_value:.2g})"
    )
