"""A term of the library adds what its text says: the text evaluated as arithmetic is the oracle."""

import numpy as np
import pytest

from hubodo.effects.empirical import ALL_HARMONICS, CHANNELS, FACTORS, empirical_class
from hubodo.effects.sensor_chain import SensorChain

SEED = 20260
BLUNT = {"sign(acceleration)": 1e-5, "temperature_rate": 2e-3}
"""By how much the term may differ: a sign is drawn out over small accelerations, a rate is fitted."""

T = np.linspace(3.0, 43.0, 4001)


def make_chain(seed=SEED):
    rng = np.random.default_rng(seed)

    def wave(mean, size):
        return mean + size * np.sin(rng.uniform(0.2, 2.0) * T + rng.uniform(0.0, 6.0))

    gyro, force = (np.stack([wave(0.0, 1.0) for _ in range(3)]) for _ in range(2))
    return SensorChain(
        t=T,
        temperature=31.0 + 6.0 * np.sin(0.11 * T),
        rate=gyro,
        rate_derivative=np.zeros_like(gyro),
        force=force,
        gyro=np.zeros((3, len(T))),
        accel=np.zeros((3, len(T))),
        angle=np.cumsum(wave(8.0, 3.0)) * 0.01,
        spin=wave(4.0, 9.0),
        acceleration=wave(0.0, 2.0),
        yaw_rate=wave(0.1, 0.7),
        speed=wave(1.0, 2.0),
    )


def read_as_arithmetic(expression, chain):
    """Return the value (N,) of the text itself, with its cosines evaluated."""
    fx, fy, fz = chain.force
    names = {
        "t": chain.t,
        "theta": chain.angle,
        "spin": chain.spin,
        "speed": chain.speed,
        "acceleration": chain.acceleration,
        "yaw_rate": chain.yaw_rate,
        "temperature": chain.temperature - 25.0,
        "temperature_rate": 6.0 * 0.11 * np.cos(0.11 * chain.t),
        "fx": fx,
        "fy": fy,
        "fz": fz,
        "pi": np.pi,
        "abs": np.abs,
        "cos": np.cos,
        "sign": np.sign,
        "step": lambda late: late >= 0.0,
    }
    return eval(expression.replace("^", "**"), names) * np.ones_like(chain.t)


def added(name, values, chain):
    kind = empirical_class(name)
    kind(**values).add_offsets(chain)
    return np.vstack([chain.gyro, chain.accel])


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize(
    "expression", [*FACTORS, "step(t-10)", "spin*temperature", "t*fx*fz", "spin^2*step(t-20.5)"]
)
def test_a_term_is_the_arithmetic_that_it_says(expression, channel):
    chain = make_chain()
    got = added(f"empirical:{channel} ~ {expression}", {channel: 0.7}, chain)
    wanted = np.zeros_like(got)
    wanted[CHANNELS.index(channel)] = 0.7 * read_as_arithmetic(expression, chain)
    clear = np.abs(chain.acceleration) > 0.3 if "sign" in expression else np.ones(len(T), bool)
    clear &= (T > 5.0) & (T < 41.0)
    np.testing.assert_allclose(got[:, clear], wanted[:, clear], atol=BLUNT.get(expression, 1e-9))


@pytest.mark.parametrize("expression", ["cos(2*theta)", "spin*cos(3*theta)", "cos(2*pi*1.25*t)"])
def test_a_periodic_term_has_a_cosine_and_a_sine(expression):
    chain = make_chain()
    got = added(f"empirical:gz,ax ~ {expression}", {"gz_cos": 0.3, "gz_sin": -0.2, "ax_sin": 2.0}, chain)
    cosine = read_as_arithmetic(expression, chain)
    sine = read_as_arithmetic(expression.replace("cos(", "cos(-pi/2+"), chain)
    np.testing.assert_allclose(got[2], 0.3 * cosine - 0.2 * sine, atol=1e-9)
    np.testing.assert_allclose(got[3], 2.0 * sine, atol=1e-9)
    assert not got[[0, 1, 4, 5]].any()


def test_all_harmonics_are_six_of_each():
    chain = make_chain()
    amplitudes = {f"gy_{turn}{k}": k + (turn == "sin") / 2 for k in range(1, 7) for turn in ("cos", "sin")}
    assert empirical_class(f"empirical:gy ~ {ALL_HARMONICS}").parameters() == tuple(amplitudes)
    got = added(f"empirical:gy ~ {ALL_HARMONICS}", amplitudes, chain)
    wanted = sum(k * np.cos(k * chain.angle) + (k + 0.5) * np.sin(k * chain.angle) for k in range(1, 7))
    np.testing.assert_allclose(got[1], wanted, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    ["gz ~ t", "empirical:gz t", "empirical:gw ~ t", "empirical:gz ~ velocity", "empirical:gz ~ cos(theta)"],
)
def test_unknown_terms_are_refused(name):
    with pytest.raises(ValueError):
        empirical_class(name)
