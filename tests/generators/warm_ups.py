"""Bias of gyros during warm-up, in several forms, without any code of hubodo. deg/s and s.

Sizes are those of MEMS and piezoelectric gyros: 0.05 to 0.5 deg/s within minutes to an hour.
"""

import numpy as np

from generators.noise import gyro_noise

NOISE = 0.1
"""deg/s, white, of a sample a second."""
FORMS = ("one exponential", "two exponentials", "power law", "1/sqrt", "heat with a lag")
ADDED = ("", "random walk", "flicker")
WALK, FLICKER = 1e-4, 20.0 / 3600.0
"""Random walk K in deg/s/sqrt(s) (6 deg/h after 5 min) and bias instability B in deg/s."""


def warm_up(form, added, seconds, rng):
    """Return (t, bias, temperature) once per second; temperature: None for a sensor without a thermometer."""
    t = np.arange(0.0, seconds)
    size = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.05), np.log(0.5)))
    constant = np.exp(rng.uniform(np.log(300.0), np.log(3600.0)))
    temperature = None
    if form == "one exponential":
        bias = size * -np.expm1(-t / constant)
    elif form == "two exponentials":
        fast = constant / rng.uniform(4.0, 10.0)
        bias = size * (rng.uniform(-0.5, 1.0) * -np.expm1(-t / fast) - np.expm1(-t / constant))
    elif form == "power law":
        bias = size * (1.0 + 3.0 * t / constant) ** -rng.uniform(0.3, 1.0)
    elif form == "1/sqrt":
        bias = size / np.sqrt(1.0 + t / 600.0)
    elif form == "heat with a lag":
        temperature, bias = heated(t, size, constant, rng)
    else:
        raise ValueError(form)
    if added == "random walk":
        bias = bias + gyro_noise(len(t), 1.0, rng, k=WALK)
    elif added == "flicker":
        bias = bias + gyro_noise(len(t), 1.0, rng, b=FLICKER)
    return t, bias, temperature


def heated(t, size, constant, rng):
    """Return the temperature of the chip, and a bias proportional to that of its package, which lags.

    The chip heats itself by 8 degrees; the temperature of the room swings by 0.5 to 2 degrees within hours.
    """
    swing = rng.uniform(0.5, 2.0) * np.sin(2 * np.pi * (t / rng.uniform(3600.0, 4 * 3600.0) + rng.uniform()))
    chip = 25.0 + swing - 8.0 * np.expm1(-t / constant)
    package = np.empty_like(chip)
    package[0], lag = chip[0], rng.uniform(20.0, 120.0)
    for k in range(1, len(t)):
        package[k] = package[k - 1] + (chip[k] - package[k - 1]) / lag
    return chip + rng.normal(0.0, 0.02, len(t)), size / 8.0 * (package - 25.0)


def heat_cycle(seconds, order, rng, hysteresis=0.0, added="", warm=0.0):
    """Return (t, output, temperature, coefficients) once per second, deg/s; a chamber swings by 15 degrees.

    The bias is a polynomial of the temperature difference from 25 °C with (order,) coefficients, deg/s/°C^n.
    hysteresis: deg/s between warming and cooling. warm: size of an exponential of 20 minutes, deg/s.
    """
    t = np.arange(0.0, seconds)
    true = 25.0 + 15.0 * np.sin(2.0 * np.pi * 1.5 * t / seconds)
    coefficients = 0.02 * np.array([1.0, 0.05, 2e-3])[:order] * rng.choice([-1.0, 1.0], order)
    coefficients *= np.exp(0.3 * rng.standard_normal(order))
    bias = sum(k * (true - 25.0) ** (n + 1) for n, k in enumerate(coefficients)) + 0.3 * rng.standard_normal()
    bias = bias + 0.5 * hysteresis * np.sign(np.gradient(true)) - warm * np.expm1(-t / 1200.0)
    if added == "random walk":
        bias = bias + gyro_noise(len(t), 1.0, rng, k=WALK)
    elif added == "flicker":
        bias = bias + gyro_noise(len(t), 1.0, rng, b=FLICKER)
    return t, bias, true + rng.normal(0.0, 0.02, len(t)), coefficients
