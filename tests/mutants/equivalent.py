"""Mutants that mean the same as the original, each with the proof: no test can tell them apart."""

from __future__ import annotations

from mutants.operators import Mutant

_SAME: dict[tuple[str, str, str], str] = {
    (
        "host/hubodo/fuse/graph/fixes.py",
        "best_count, previous_run = run_length.astype(np.float64), np.full(len(first), -1)",
        "1 -> 2",
    ): "the way back from run to run ends at whatever is below 0",
    (
        "firmware/radio/espnow_air.py",
        "self._came: Any = [None, bytearray(MOST), 0, 0]",
        "0 -> 1",
    ): "both places are written by `recvinto` before either is read",
    (
        "firmware/drivers/lsm6ds33.py",
        "seen = -1",
        "1 -> 2",
    ): "it is compared with counts whose low byte is at least 250",
    (
        "firmware/drivers/lsm6ds33.py",
        "seen = -1",
        "- -> ",
    ): "it is compared with counts whose low byte is at least 250",
    (
        "host/hubodo/fuse/wheel/spin_search.py",
        "chirp = sample_set.best(chirp.excess + offsets, chirp.slope + 0.1 * max_slope * offsets)",
        "+ -> -",
    ): "what is looked at reaches as far to either side: the same places in another order",
    (
        "host/hubodo/fuse/wheel/spin_search.py",
        ".best(chirp.excess + rate_range * _SEARCH_GRID, chirp.slope + fine_step * _SEARCH_GRID, sign)",
        "+ -> -",
    ): "what is looked at reaches as far to either side: the same places in another order",
    (
        "host/hubodo/fuse/wheel/rate_beyond_range.py",
        "if wheel.angle_initialised and (is_unobserved or angle_variance > _MAX_ANGLE_SIGMA**2):",
        "2 -> 3",
    ): "it is one radian, and one to any power is one",
    (
        "host/hubodo/fuse/graph/alignment.py",
        "second = (first + (0.25 + 0.5 * (k * 0.7548776662 % 1.0)) * n).astype(np.intp) % n",
        "0.25 -> 1.25",
    ): "it is taken modulo n: n further is the same fix",
    (
        "host/hubodo/fuse/differential_odometry.py",
        "self._covariance = [[0.0] * 3 for _ in range(3)]",
        "3 -> 4",
    ): "a row or column beyond the third is never looked at",
    (
        "host/hubodo/fuse/differential_odometry.py",
        "self._jacobian = [[0.0] * 6 for _ in range(3)]",
        "6 -> 7",
    ): "a column beyond the sixth is never looked at",
    (
        "host/hubodo/fuse/heading_filter.py",
        "count = math.ceil(math.log(_MAX_FLICKER_TIME / _MIN_FLICKER_TIME, _FLICKER_TIME_RATIO))",
        "/ -> *",
    ): "the shortest is 1 s",
    (
        "host/hubodo/fuse/heading_filter.py",
        "powers = np.arange(count if noise.bias_instability else 0)",
        "0 -> 1",
    ): "a flicker without size, in which nothing ever is",
    (
        "host/hubodo/effects/one_pole.py",
        "keep = np.concatenate([[0.0], decay])",
        "0.0 -> 1.0",
    ): "places before `reach` are looked at no more: what is made of the first one stays among them",
    (
        "host/hubodo/effects/one_pole.py",
        "while reach < len(t) and keep.max() > 1e-13:",
        "and -> or",
    ): "further steps add what has faded, and beyond the last sample nothing",
    (
        "host/hubodo/sensors/north/east.py",
        "angle += math.pi",
        "+ -> -",
    ): "half a turn either way ends at the same angle, which is wrapped",
    (
        "host/hubodo/sensors/north/likelihood.py",
        'between = np.einsum("k,ki,kj->ij", weight, means - centre, means - centre)',
        "- -> +",
    ): "`centre` is the weighted mean: what is added is 2 centre times the mean distance from it, 0",
    (
        "host/hubodo/sensors/imu/calibrate.py",
        "if fdtrc(9, 3 * dof, max(ratio, 0.0)) > MAX_G_SENSITIVITY_P_VALUE:",
        "0.0 -> 1.0",
    ): "a ratio of 1 is as little believed as one of 0, whatever the freedom",
    (
        "host/hubodo/sensors/imu/calibrate.py",
        "if g_sensitivity is not None and g_sigma is not None:",
        "and -> or",
    ): "`estimate_static_bias` gives both or neither",
}
"""By path, what the line says, and the change: why nothing changes."""


def is_equivalent(mutant: Mutant, line: str) -> bool:
    """line: the text of the line that the mutant is in."""
    return (mutant.path, line.strip(), f"{mutant.old.strip()} -> {mutant.new.strip()}") in _SAME
