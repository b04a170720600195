"""The fit of eq. 1 of Barshan and Durrant-Whyte to a simulated night, and its whiteness, beside theirs."""

import math

import numpy as np

from generators import start_gyro as start
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.fit import fit_warmup

DEG = math.pi / 180.0


def print_fit(seed: int) -> None:
    print(f"Fit of eq. (1) to 12 h at rest (seed {seed})")
    print(f"{'':34}{'C1 deg/s':>18}{'C2 deg/s':>20}{'T min':>16}")
    print(f"{'paper':34}{0.300:>18.3f}{-0.326:>20.3f}{63.6:>16.1f}")
    for text, interval in (("ours, a sample a minute as there", 60.0), ("ours, every 50 ms", start.DT)):
        t, output = start.overnight(interval, 12 * 3600.0, np.random.default_rng(seed))
        if interval == 60.0:
            fit = fit_warmup(t, output * DEG)
        else:
            report = characterise_warmup(t, output * DEG, "gz")
            fit, test = report.exponential.fit, report.exponential
        c1, c2, constant = (fit.values[name] for name in ("c1", "c2", "time_constant"))
        s1, s2, spread = (fit.sigma[name] for name in ("c1", "c2", "time_constant"))
        print(
            f"{text:34}{c1 / DEG:>9.4f} ± {s1 / DEG:<6.4f}{c2 / DEG:>11.4f} ± {s2 / DEG:<6.4f}"
            f"{constant / 60:>9.2f} ± {spread / 60:<4.2f}  ({fit.evaluations} evaluations)"
        )
    a = test.autocorrelation
    print(
        f"whiteness, {a.sequences} sequences of {a.length * start.DT:g} s: inside ±2 standard errors paper "
        "96 %, ours "
        f"{a.share_within_two_sigma:.1%} (white noise: {a.expected_share_within_two_sigma:.1%}); "
        f"±1: {a.share_within_one_sigma:.1%} "
        f"({a.expected_share_within_one_sigma:.1%}); "
        f"Ljung-Box p = {test.ljung_box.p_value:.2f}; white: {test.is_white}\n"
    )
