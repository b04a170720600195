"""Equivalent mutants with the reason: they do not change the behaviour, so no test can kill them."""

from __future__ import annotations

from mutants.operators import Mutant

_PROOF_BY_MUTANT: dict[tuple[str, str, str], str] = {
    (
        "host/hubodo/fuse/graph/fixes.py",
        "best_count, previous_run = run_length.astype(np.float64), np.full(len(first), -1)",
        "1 -> 2",
    ): "the backtracking over runs ends at any negative value",
    (
        "firmware/radio/espnow_air.py",
        "self._came: Any = [None, bytearray(MAX_PACKET), 0, 0]",
        "0 -> 1",
    ): "`recvinto` writes both elements before either is read",
    (
        "firmware/drivers/lsm6ds33.py",
        "last = -1",
        "1 -> 2",
    ): "the initial value is compared only with counts whose low byte is at least 250",
    (
        "firmware/drivers/lsm6ds33.py",
        "last = -1",
        "- -> ",
    ): "the initial value is compared only with counts whose low byte is at least 250",
    (
        "host/hubodo/fuse/wheel/spin_search.py",
        "chirp = sample_set.fit_chirp(chirp.excess + offsets, chirp.slope + 0.1 * max_slope * offsets)",
        "+ -> -",
    ): "the grid is symmetric: the same values in another order",
    (
        "host/hubodo/fuse/wheel/spin_search.py",
        "chirp.excess + rate_range * _SEARCH_GRID, chirp.slope + fine_step * _SEARCH_GRID, sign",
        "+ -> -",
    ): "the grid is symmetric: the same values in another order",
    (
        "host/hubodo/fuse/graph/alignment.py",
        "second = (first + (0.25 + 0.5 * (k * 0.7548776662 % 1.0)) * n).astype(np.intp) % n",
        "0.25 -> 1.25",
    ): "the index is taken modulo n",
    (
        "host/hubodo/fuse/differential_odometry.py",
        "self._covariance = [[0.0] * 3 for _ in range(3)]",
        "3 -> 4",
    ): "rows and columns beyond the third are never read",
    (
        "host/hubodo/fuse/differential_odometry.py",
        "self._jacobian = [[0.0] * 6 for _ in range(3)]",
        "6 -> 7",
    ): "columns beyond the sixth are never read",
    (
        "host/hubodo/fuse/heading_filter.py",
        "count = math.ceil(math.log(_MAX_FLICKER_TIME / _MIN_FLICKER_TIME, _FLICKER_TIME_RATIO))",
        "/ -> *",
    ): "the minimum is 1 s",
    (
        "host/hubodo/fuse/heading_filter.py",
        "powers = np.arange(count if noise.bias_instability else 0)",
        "0 -> 1",
    ): "a flicker component of zero size has no effect",
    (
        "host/hubodo/effects/one_pole.py",
        "memory = np.concatenate([[0.0], decay])",
        "0.0 -> 1.0",
    ): "elements before `span` are never read again, and the first one affects only these",
    (
        "host/hubodo/effects/one_pole.py",
        "while span < len(t) and memory.max() > 1e-13:",
        "and -> or",
    ): "further iterations add terms below 1e-13, and none beyond the last sample",
    (
        "host/hubodo/sensors/north/east.py",
        "angle += math.pi",
        "+ -> -",
    ): "the angle is wrapped, so half a turn in either direction is the same",
    (
        "host/hubodo/sensors/north/likelihood.py",
        'between = np.einsum("k,ki,kj->ij", weight, means - centre, means - centre)',
        "- -> +",
    ): "`centre` is the weighted mean, so the added term, 2 centre times the mean deviation, is 0",
    (
        "host/hubodo/sensors/imu/calibrate.py",
        "if fdtrc(9, 3 * dof, max(ratio, 0.0)) > MAX_G_SENSITIVITY_P_VALUE:",
        "0.0 -> 1.0",
    ): "ratios of 0 and 1 are both insignificant for any degrees of freedom",
    (
        "host/hubodo/sensors/imu/result.py",
        "if g_sensitivity is not None and g_sigma is not None:",
        "and -> or",
    ): "`estimate_static_bias` returns both or neither",
}
"""Reason for the equivalence by path, source line and change."""


def is_equivalent(mutant: Mutant, line: str) -> bool:
    """Return True if a mutant is listed as equivalent.

    line: source line of the mutant
    """
    return (mutant.path, line.strip(), f"{mutant.old.strip()} -> {mutant.new.strip()}") in _PROOF_BY_MUTANT
