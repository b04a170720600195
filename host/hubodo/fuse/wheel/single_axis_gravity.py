"""Rotation of gravity in samples of which one accelerometer axis may be saturated.

On a fast wheel the centripetal force on the lever arm saturates the axis along the arm, while the axis at
right angles to it still measures gravity. Each axis of each sample is used separately:

    fx = a cos φ + b sin φ,    fy = b cos φ - a sin φ,    φ = carrier + u t + s t²/2

a + ib is the amplitude of e^(-iφ), u the rate beyond range and s its slope. For each pair (u, s), a and b
follow by linear least squares together with a polynomial of time for each axis (bias and lever arm). With
both axes in range throughout this is the fit of `gravity_rotation.py`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.gravity_rotation import MIN_SEARCH_SAMPLES, RATE_TOLERANCE, Chirp, GravitySamples
from hubodo.fuse.wheel.measurements.steady import NodeFixedTerms
from hubodo.fuse.wheel.thresholds import MAX_MISSING_SHARE

_MIN_AMPLITUDE_RATIO = 6.0
"""Ratio of the amplitude and its standard deviation. The maximum over some thousand pairs of rate and slope
of pure noise reaches 4."""


class SingleAxisSamples(NamedTuple):
    """Samples of consecutive windows with the validity of each accelerometer axis.

    t, carrier_angle, rate, across, centre: see `GravitySamples`. force: m/s², (N, 2), x and y; in_range: (N,
    2), 1.0 where the axis is in range, else 0.0. basis: (2, N, k) orthonormal polynomials of each axis
    already removed from the force.
    """

    t: Array
    carrier_angle: Array
    rate: Array
    across: Array
    centre: float
    force: Array
    in_range: Array
    basis: Array

    @staticmethod
    def from_samples(samples: GravitySamples, in_range: Array) -> SingleAxisSamples | None:
        """Return the samples of the axes in range; None if there are too few.

        in_range: (N, 2), True where an axis of a sample is in range.
        """
        # On an axis with less in range, clipping selects the samples in which vibration reduces the force.
        is_used = in_range & (np.mean(in_range, axis=0) >= 1.0 - MAX_MISSING_SHARE)
        if np.count_nonzero(is_used) < MIN_SEARCH_SAMPLES:
            return None
        force = np.column_stack([samples.force.real, samples.force.imag]) * is_used
        basis = np.empty((2, len(samples.t), 0))
        return SingleAxisSamples(*samples[:4], samples.centre, force, is_used.astype(float), basis)

    @property
    def n_values(self) -> float:
        """Return the number of values in range, of both axes together."""
        return float(np.sum(self.in_range))

    def subtract_force(self, force: Any) -> SingleAxisSamples:
        """Return the samples with a known force subtracted.

        force: m/s², ax + i ay; one number or (N,).
        """
        components = np.stack([np.real(force), np.imag(force)], axis=-1)
        return self._replace(force=self.force - components * self.in_range)

    def remove_polynomial(self, order: int) -> SingleAxisSamples:
        """Remove a polynomial of time with `order` coefficients from each axis, for bias and lever arm."""
        powers, force, basis = self.t[:, None] ** np.arange(order), self.force.copy(), []
        for axis in range(2):
            flags = self.in_range[:, axis]
            functions = np.linalg.qr(powers * flags[:, None])[0] * flags[:, None]
            force[:, axis] -= functions @ (functions.T @ force[:, axis])
            basis.append(functions)
        return self._replace(force=force, basis=np.array(basis))

    def fit_chirp(self, rates: Array, slopes: Array, sign: float = 0.0) -> Chirp:
        """Return the chirp with the smallest residual among candidate rates, rad/s, and slopes, rad/s².

        sign: see `GravitySamples.fit_chirp`. An amplitude that is not significant is returned as zero.
        """
        t, order = self.t, self.basis.shape[2]
        phase = self.carrier_angle + 0.5 * slopes[:, None] * t * t
        signals = np.column_stack([self.force, self.basis[0], self.basis[1]])
        sums = _derotated_sums(rates, t, np.exp(-1j * phase), signals)
        double = _derotated_sums(
            2.0 * rates, t, np.exp(-2j * phase), (self.in_range[:, :1] - self.in_range[:, 1:])
        )[:, :, 0]
        by_x, by_y = sums[:, :, 2 : 2 + order], sums[:, :, 2 + order :]
        half = 0.5 * self.n_values
        # Normal equations of a and b, without the part that the polynomials absorb.
        n_aa = half + 0.5 * double.real - np.sum(by_x.real**2 + by_y.imag**2, axis=2)
        n_bb = half - 0.5 * double.real - np.sum(by_x.imag**2 + by_y.real**2, axis=2)
        n_ab = -0.5 * double.imag + np.sum(by_x.real * by_x.imag - by_y.imag * by_y.real, axis=2)
        r_a, r_b = sums[:, :, 0].real + sums[:, :, 1].imag, sums[:, :, 1].real - sums[:, :, 0].imag
        # A determinant near zero belongs to a rotation that the polynomials absorb.
        determinant = np.maximum(n_aa * n_bb - n_ab * n_ab, (0.1 * half) ** 2)
        a, b = (n_bb * r_a - n_ab * r_b) / determinant, (n_aa * r_b - n_ab * r_a) / determinant
        power = a * r_a + b * r_b
        half_duration = 0.5 * (t[-1] - t[0])
        power[sign * rates[:, None] - abs(sign) * half_duration * np.abs(slopes) < -RATE_TOLERANCE] = 0.0
        rate, slope = np.unravel_index(int(np.argmax(power)), power.shape)
        amplitude = complex(a[rate, slope], b[rate, slope])
        residual = max(float(np.sum(self.force**2) - power[rate, slope]), 0.0)
        variance = residual / max(self.n_values - 2.0 * order - 2.0, 1.0) / half
        if abs(amplitude) ** 2 < _MIN_AMPLITUDE_RATIO**2 * variance:
            amplitude = 0j
        return Chirp(float(rates[rate]), float(slopes[slope]), amplitude)

    def average_fixed_terms(self, chirp: Chirp, radius: float) -> NodeFixedTerms:
        """Return the mean rates that do not rotate with the chirp; radius: m, of the wheel.

        The mean force of a saturated axis is unknown, so the force has an infinite variance.
        """
        terms = GravitySamples(
            self.t,
            self.carrier_angle,
            self.rate,
            self.across,
            np.zeros(len(self.t), complex),
            self.centre,
            self.t,
        ).average_fixed_terms(chirp, radius)
        return terms._replace(force_variance=math.inf)


def _derotated_sums(rates: Array, t: Array, derotation: Array, signals: Array) -> Array:
    """Return Σ signal e^(-i rate t) derotation over the samples, (rates, slopes, signals)."""
    columns = (derotation[:, :, None] * signals).transpose(1, 0, 2).reshape(len(t), -1)
    sums: Array = (np.exp(-1j * np.outer(rates, t)) @ columns).reshape(
        len(rates), len(derotation), signals.shape[1]
    )
    return sums
