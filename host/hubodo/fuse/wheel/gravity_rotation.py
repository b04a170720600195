"""Rotation of gravity in the samples of a few windows: rate, slope and phase by maximum likelihood.

The force across the axle is g e^(-iθ) plus terms that hardly change: bias and the force on the lever arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.measurements.steady import NodeFixedTerms
from hubodo.fuse.wheel.window import WINDOW_S, Window

MAX_GRAVITY_RATIO = 1.5
"""Ratio of the rotating force and gravity up to which it is accepted as gravity, either way. Estimated."""

MIN_SEARCH_SAMPLES = 25
"""Samples for a search, a quarter of a second at 104 Hz; fewer do not separate gravity from the lever arm."""

RATE_TOLERANCE = 2.0
"""rad/s by which a spin may lie below the saturation limit: a few percent of scale, bias and search error. A
saturated gyro bounds the rate from below. Estimated.
"""


class Chirp(NamedTuple):
    """Amplitude, m/s², of a rotating force with a rate beyond range, rad/s, that changes by slope, rad/s²."""

    excess: float
    slope: float
    amplitude: complex

    @property
    def is_gravity(self) -> bool:
        return 1.0 / MAX_GRAVITY_RATIO < abs(self.amplitude) / STANDARD_GRAVITY < MAX_GRAVITY_RATIO


class GravitySamples(NamedTuple):
    """Samples of consecutive windows.

    t: s from `centre`, (N,); carrier_angle: rad, integral of the measured gz; rate: rad/s, gz; across: rad/s,
    gx + i gy; force: m/s², ax + i ay. basis: (N, k) orthonormal polynomials already removed from the force.
    """

    t: Array
    carrier_angle: Array
    rate: Array
    across: Array
    force: Array
    centre: float
    basis: Array

    @staticmethod
    def from_windows(windows: Sequence[Window]) -> tuple[GravitySamples, Array] | None:
        """Return the samples of windows with a clipped gyro, and flags (N, 2) of ax and ay in range.

        Returns None if there are too few samples.
        """
        clipped = [(w, w.samples) for w in windows if w.samples is not None and w.missing == 0.0]
        in_range = np.array(
            [flags for _, s in clipped for flags in zip(s.x_in_range, s.y_in_range, strict=True)], bool
        )
        if len(in_range) < MIN_SEARCH_SAMPLES:
            return None
        centre = 0.5 * (clipped[0][0].number + clipped[-1][0].number + 1) * WINDOW_S
        t = np.concatenate([np.array(s.time) + ((w.number + 0.5) * WINDOW_S - centre) for w, s in clipped])
        carrier_angle = np.concatenate([np.array(s.angle) + w.clock_angle for w, s in clipped])
        rate, across, force = (np.concatenate([s[row] for _, s in clipped]) for row in (2, 4, 5))
        return GravitySamples(t, carrier_angle, rate, across, force, centre, np.empty(0)), in_range

    def subtract_force(self, force: Any) -> GravitySamples:
        """Return the samples with a known force subtracted.

        force: m/s², ax + i ay; one number or (N,).
        """
        return self._replace(force=self.force - force)

    def remove_polynomial(self, order: int) -> GravitySamples:
        """Remove a polynomial of time with `order` coefficients, for bias and lever arm."""
        basis, _ = np.linalg.qr(self.t[:, None] ** np.arange(order))
        return self._replace(force=self.force - basis @ (basis.T @ self.force), basis=basis)

    def fit_chirp(self, rates: Array, slopes: Array, sign: float = 0.0) -> Chirp:
        """Return the chirp with the smallest residual among candidate rates, rad/s, and slopes, rad/s².

        sign: sign of the limit if the gyro was saturated all the time, which excludes slower rates; else 0.0.
        The force across the axle is g e^(-iθ): maximum-likelihood estimate of a complex chirp in white noise
        (Abatzoglou 1986).
        """
        t, count = self.t, len(self.t)
        derotation = np.exp(-1j * (self.carrier_angle + 0.5 * slopes[:, None] * t * t))
        # The basis is already removed from the force, so the overlap of a tone with it only reduces its
        # size.
        projections = np.column_stack([self.basis, self.force.conj()])
        columns = (derotation[:, :, None] * projections).transpose(1, 0, 2).reshape(count, -1)
        projected = np.exp(-1j * np.outer(rates, t)) @ columns
        projected = projected.reshape(len(rates), len(slopes), projections.shape[1])
        residual_size = np.maximum(count - np.sum(np.abs(projected[:, :, :-1]) ** 2, axis=2), 0.1 * count)
        fit = projected[:, :, -1].conj() / residual_size
        half_duration = 0.5 * (t[-1] - t[0])
        fit[sign * rates[:, None] - abs(sign) * half_duration * np.abs(slopes) < -RATE_TOLERANCE] = 0.0
        power = np.abs(fit) ** 2 * residual_size
        rate, slope = np.unravel_index(int(np.argmax(power)), power.shape)
        return Chirp(float(rates[rate]), float(slopes[slope]), complex(fit[rate, slope]))

    def average_fixed_terms(self, chirp: Chirp, radius: float) -> NodeFixedTerms:
        """Return the mean force and rates that do not rotate with the chirp; radius: m, of the wheel."""
        t, spin = self.t, self.rate + chirp.excess + chirp.slope * self.t
        rotation = np.exp(-1j * (self.carrier_angle + chirp.excess * t + 0.5 * chirp.slope * t * t))
        basis = np.column_stack([np.ones(len(t)), rotation])
        signals = np.column_stack([self.force, self.across])
        fit = np.linalg.lstsq(basis, signals, rcond=None)[0]
        # A wheel bounces on its tyre at some 10 Hz, a cycle per window, so windows count as independent.
        residual_variance = (
            0.5 * np.mean(np.abs(signals - basis @ fit) ** 2, axis=0) * WINDOW_S / (t[-1] - t[0])
        )
        lever_factor = complex(-float(np.mean(spin * spin)), chirp.slope)
        force, rate = (complex(value) for value in fit[0])
        return NodeFixedTerms(
            force,
            rate,
            float(residual_variance[0]),
            float(residual_variance[1]),
            float(np.mean(spin)),
            lever_factor,
            radius,
        )
