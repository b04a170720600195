"""The sensor chain of the forward model: each effect against an independent formula.

Also tested: the order of the chain against a slow version, sample by sample, and that an absent effect
changes nothing.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from hubodo.effects import BY_NAME, EFFECTS, Effect, Noise
from hubodo.effects.accel import AccelSaturation
from hubodo.effects.gyro import (
    GyroBias,
    GyroLag,
    GyroQuantization,
    GyroRateRandomWalk,
    GyroSaturation,
)
from hubodo.effects.mounting import NodeMisalignment
from hubodo.effects.timing import ClockSkew, Outliers, SampleRepeat, TimeOffset
from hubodo.effects.warmup import GyroWarmup
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.inputs import MotionInputs, Trace
from hubodo.smoothing_spline import fit_interpolating_spline
from hubodo.vehicle import NodeMount

QUIET = Noise(0.0, 0.0)
END = 8.0


def drive():
    t = np.arange(0.0, END + 0.005, 0.01)
    return MotionInputs(
        fit_interpolating_spline(t, 1.5 + np.sin(0.7 * t)),
        fit_interpolating_spline(t, 0.6 * np.cos(0.9 * t)),
        Trace(np.array([0.0, END]), np.array([20.0, 45.0])),
    )


def forward(t=None, power_on=0.0):
    t = np.arange(0.0, END, 0.005) if t is None else t
    return NodeModel(drive(), t, NodeMount("left", "left"), 0.31, 0.92, power_on)


def noise_free(effects=(), t=None, power_on=0.0):
    """Return (gyro, accel), (3, N) each, without any random effect."""
    reading = forward(t, power_on).mean_reading(list(effects), NodeInitialState(0.3))
    return reading.gyro, reading.accel


def sent(effects, seed=1, noise=QUIET, t=None):
    reading = forward(t).draw_reading(
        list(effects), NodeInitialState(0.3), noise, np.random.default_rng(seed)
    )
    return reading.gyro, reading.accel


def sized(name, **some):
    """Return the effect with distinct parameters, or with those given."""
    kind = BY_NAME[name]
    values = {p: kind.scale(p) * (1.0 + 0.3 * k) for k, p in enumerate(kind.parameters())}
    return kind(**(values | some))


def polynomial(e, d):
    """Return the polynomials of a temperature difference d (N,), (3, N)."""
    coefficients = [
        [e.x, e.y, e.z],
        [e.x_quadratic, e.y_quadratic, e.z_quadratic],
        [e.x_cubic, e.y_cubic, e.z_cubic],
    ]
    return sum(np.outer(row, d ** (n + 1)) for n, row in enumerate(coefficients))


# Each line: change of gyro and accelerometer by the effect, from rate w and force f (3, N), age and
# temperature (N,).
ADDS = {
    "gyro_bias": lambda e, w, f, age, warm: (np.array([[e.x], [e.y], [e.z]]), 0),
    "accel_bias": lambda e, w, f, age, warm: (0, np.array([[e.x], [e.y], [e.z]])),
    "gyro_scale_factor": lambda e, w, f, age, warm: (np.stack([e.x * w[0], e.y * w[1], e.z * w[2]]), 0),
    "accel_scale_factor": lambda e, w, f, age, warm: (0, np.stack([e.x * f[0], e.y * f[1], e.z * f[2]])),
    "gyro_nonorthogonality": lambda e, w, f, age, warm: (
        np.stack(
            [e.xz * w[1] - e.xy * w[2], -e.yz * w[0] + e.yx * w[2], e.zy * w[0] - e.zx * w[1]],
        ),
        0,
    ),
    "accel_nonorthogonality": lambda e, w, f, age, warm: (
        0,
        np.stack([e.xz * f[1] - e.xy * f[2], -e.yz * f[0] + e.yx * f[2], e.zy * f[0] - e.zx * f[1]]),
    ),
    "gyro_cubic": lambda e, w, f, age, warm: (np.stack([0 * w[0], 0 * w[0], e.z * w[2] * w[2] * w[2]]), 0),
    "gyro_warmup": lambda e, w, f, age, warm: (
        np.outer([e.x, e.y, e.z], 1.0 - np.exp(-age / e.time_constant))
        + np.outer([e.x_second, e.y_second, e.z_second], 1.0 - np.exp(-age / e.time_constant_second)),
        0,
    ),
    "gyro_temperature": lambda e, w, f, age, warm: (polynomial(e, warm - 25.0), 0),
    "accel_temperature": lambda e, w, f, age, warm: (0, polynomial(e, warm - 25.0)),
    "gyro_scale_temperature": lambda e, w, f, age, warm: (np.outer([e.x, e.y, e.z], warm - 25.0) * w, 0),
    "accel_scale_temperature": lambda e, w, f, age, warm: (0, np.outer([e.x, e.y, e.z], warm - 25.0) * f),
    "gyro_g_sensitivity": lambda e, w, f, age, warm: (
        np.stack(
            [
                e.xx * f[0] + e.xy * f[1] + e.xz * f[2],
                e.yx * f[0] + e.yy * f[1] + e.yz * f[2],
                e.x * f[0] + e.y * f[1] + e.z * f[2],
            ]
        ),
        0,
    ),
}


@pytest.mark.parametrize("name", ADDS)
def test_each_effect_adds_the_value_of_its_formula(name):
    t = np.arange(0.0, END, 0.005)
    rate, force = noise_free()
    effect = sized(name)
    gyro, accel = noise_free([effect], power_on=-30.0)
    more, further = ADDS[name](effect, rate, force, t + 30.0, 20.0 + 25.0 * t / END)
    np.testing.assert_allclose(gyro, rate + more, rtol=0, atol=1e-12)
    np.testing.assert_allclose(accel, force + further, rtol=0, atol=1e-12)
    assert not np.allclose(gyro, rate, atol=1e-7) or not np.allclose(accel, force, atol=1e-7)


def test_a_misaligned_node_measures_vectors_rotated_back():
    rate, force = noise_free()
    gyro, accel = noise_free([NodeMisalignment(0.02, -0.05, 0.4)])
    turn = Rotation.from_rotvec([0.02, -0.05, 0.4]).inv()
    np.testing.assert_allclose(gyro, turn.apply(rate.T).T, atol=1e-12)
    np.testing.assert_allclose(accel, turn.apply(force.T).T, atol=1e-12)
    # By hand: the node is turned by a small angle about its z axis, so its x axis measures a part of y.
    small = noise_free([NodeMisalignment(z=1e-6)])[1]
    np.testing.assert_allclose(small[0] - force[0], 1e-6 * force[1], rtol=1e-3, atol=1e-9)


def test_the_lag_of_the_gyro_is_the_solution_of_its_differential_equation():
    t = np.arange(0.0, END, 0.005)
    rate, _ = noise_free()
    gyro, _ = noise_free([GyroLag(0.03)])
    fine = NodeModel(drive(), np.arange(0.0, END, 0.0005), NodeMount("left", "left"), 0.31, 0.92)
    true = fine.mean_reading([], NodeInitialState(0.3)).gyro
    signal = make_interp_spline(fine.stamps, true.T, 5)
    solution = solve_ivp(
        lambda x, y: (signal(x) - y) / 0.03,
        (0.0, t[-1]),
        rate[:, 0],
        t_eval=t,
        max_step=0.01,
        rtol=1e-8,
        atol=1e-9,
    )
    np.testing.assert_allclose(gyro, solution.y, rtol=0, atol=2e-6)


def test_stamps_have_the_delay_and_the_skew():
    t = np.arange(1.0, 6.0, 0.005)
    rate, force = noise_free(t=t)
    late_rate, late_force = noise_free([TimeOffset(0.04)], t=t + 0.04)
    np.testing.assert_allclose(late_rate, rate, atol=1e-9)
    np.testing.assert_allclose(late_force, force, atol=1e-8)
    skewed_rate, _ = noise_free([ClockSkew(300.0)], t=t * 1.0003)
    np.testing.assert_allclose(skewed_rate, rate, atol=1e-8)
    assert not np.allclose(noise_free([TimeOffset(0.04)], t=t)[0], rate, atol=1e-3)


def test_readings_are_clipped_before_they_are_quantised():
    """Calculated by hand: limit 1.0 and steps of 0.3; the largest reading is three steps, 0.9."""
    rate, force = noise_free()
    gyro, accel = noise_free([GyroSaturation(1.0), AccelSaturation(6.0)])
    np.testing.assert_array_equal(gyro, np.minimum(np.maximum(rate, -1.0), 1.0))
    np.testing.assert_array_equal(accel, np.minimum(np.maximum(force, -6.0), 6.0))
    assert (rate > 1.0).any()
    stepped, _ = sent([GyroSaturation(1.0), GyroQuantization(0.3)])
    assert stepped.max() == pytest.approx(0.9)
    np.testing.assert_allclose(stepped / 0.3, np.rint(stepped / 0.3), atol=1e-9)


def test_rounding_is_to_the_nearest_step():
    gyro, _ = sent([GyroQuantization(0.01)])
    rate, _ = noise_free()
    assert np.abs(gyro - rate).max() <= 0.005 + 1e-12
    assert np.unique(np.round(gyro / 0.01, 6)).size < gyro.size / 3


def test_a_repeated_sample_has_all_six_values_of_its_predecessor():
    gyro, accel = sent([SampleRepeat(0.3)], seed=4)
    rate, force = noise_free()
    stale = gyro[2, 1:] == gyro[2, :-1]
    assert np.mean(stale) == pytest.approx(0.3, abs=0.04)
    for read, true in ((gyro, rate), (accel, force)):
        np.testing.assert_array_equal(read[:, 1:][:, stale], read[:, :-1][:, stale])
        np.testing.assert_array_equal(read[:, 1:][:, ~stale], true[:, 1:][:, ~stale])


def test_outliers_have_their_probability_and_size():
    noise = Noise(0.01, 0.1)
    t = np.linspace(0.0, END, 40001)[:-1]
    plain, wild = sent([], 5, noise, t), sent([Outliers(0.02, 50.0)], 5, noise, t)
    for a, b, one in zip(plain, wild, (0.01, 0.1), strict=True):
        off = (b - a)[a != b]
        assert off.size / a.size == pytest.approx(0.02, rel=0.1)
        assert np.std(off) == pytest.approx(50.0 * one, rel=0.1)


def test_a_random_walk_grows_with_the_square_root_of_time_also_for_uneven_stamps():
    t = np.sort(np.random.default_rng(1).uniform(0.0, END, 400))
    rate, _ = noise_free(t=t)
    walks = np.stack([sent([GyroRateRandomWalk(0.02)], seed, t=t)[0] - rate for seed in range(200)])
    assert walks[..., 0] == pytest.approx(0.0)
    for at in (100, 399):
        assert np.std(walks[..., at]) == pytest.approx(0.02 * np.sqrt(t[at] - t[0]), rel=0.1)
    assert abs(np.corrcoef(walks[:, 0, -1], walks[:, 2, -1])[0, 1]) < 0.2


def test_noise_has_the_size_that_the_model_file_gives():
    noise = Noise(0.02, 0.3)
    gyro, accel = sent([], 2, noise)
    rate, force = noise_free()
    assert np.std(gyro - rate) == pytest.approx(0.02, rel=0.05)
    assert np.std(accel - force) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_with_default_parameters_changes_nothing(kind):
    plain, with_it = noise_free(), noise_free([kind()])
    for a, b in zip(plain, with_it, strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(sent([]), sent([kind()]), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", EFFECTS)
def test_each_effect_alone_changes_the_readings(kind):
    some = {"limit": 2.0} if "limit" in kind.parameters() else {}
    noise = Noise(0.01, 0.1)
    plain, with_it = sent([], 3, noise), sent([sized(kind.name, **some)], 3, noise)
    assert any(not np.array_equal(a, b) for a, b in zip(plain, with_it, strict=True))
    assert kind.visible_in == "scatter" or any(
        not np.array_equal(a, b) for a, b in zip(noise_free(), noise_free([sized(kind.name)]), strict=True)
    )


def slow_chain(values, w, f, age, warm):
    """Return one sample after the whole chain, in order; values: effect name -> its parameters."""

    def of(name, axes):
        return np.array([values[name][a] for a in axes])

    turn = Rotation.from_rotvec(of("node_misalignment", "xyz")).inv()
    w, f = turn.apply(w), turn.apply(f)
    shown = w.copy()
    for triad, vector in (("gyro", w), ("accel", f)):
        n = values[f"{triad}_nonorthogonality"]
        matrix = np.array([[0, n["xz"], -n["xy"]], [-n["yz"], 0, n["yx"]], [n["zy"], -n["zx"], 0]])
        result = vector + of(f"{triad}_scale_factor", "xyz") * vector + matrix @ vector
        result = result + (warm - 25.0) * of(f"{triad}_scale_temperature", "xyz") * vector
        if triad == "gyro":
            shown = result
            shown[2] += values["gyro_cubic"]["z"] * vector[2] ** 3
        else:
            read = result
    warmup = values["gyro_warmup"]
    shown = shown + of("gyro_bias", "xyz")
    shown = shown + of("gyro_warmup", "xyz") * (1 - np.exp(-age / warmup["time_constant"]))
    second = of("gyro_warmup", ("x_second", "y_second", "z_second"))
    shown = shown + second * (1 - np.exp(-age / warmup["time_constant_second"]))
    for n, suffix in enumerate(("", "_quadratic", "_cubic")):
        names = [axis + suffix for axis in "xyz"]
        shown = shown + of("gyro_temperature", names) * (warm - 25.0) ** (n + 1)
        read = read + of("accel_temperature", names) * (warm - 25.0) ** (n + 1)
    for axis, names in enumerate((("xx", "xy", "xz"), ("yx", "yy", "yz"), "xyz")):
        shown[axis] += of("gyro_g_sensitivity", names) @ f
    read = read + of("accel_bias", "xyz")
    limit, step = values["gyro_saturation"]["limit"], values["gyro_quantization"]["step"]
    shown = np.round(np.clip(shown, -limit, limit) / step) * step
    return shown, np.clip(read, -values["accel_saturation"]["limit"], values["accel_saturation"]["limit"])


SENSOR = [
    kind.name
    for kind in EFFECTS
    if kind.name.startswith(("gyro", "accel", "node")) and kind not in (GyroLag, GyroRateRandomWalk)
]


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_all_effects_of_the_sensor_together_act_in_the_order_of_the_chain(seed):
    rng = np.random.default_rng(seed)
    values = {
        name: {p: float(rng.normal() * BY_NAME[name].scale(p)) for p in BY_NAME[name].parameters()}
        for name in SENSOR
    }
    values["gyro_warmup"] |= {"time_constant": 40.0, "time_constant_second": 900.0}
    values["gyro_saturation"]["limit"], values["accel_saturation"]["limit"] = 4.0, 7.0
    values["gyro_quantization"]["step"] = 0.01
    effects: list[Effect] = [BY_NAME[name](**values[name]) for name in SENSOR]
    t = np.sort(rng.uniform(0.0, END, 30))
    rate, force = noise_free(t=t)
    result = forward(t).draw_reading(effects, NodeInitialState(0.3), QUIET, rng)
    for i in range(len(t)):
        gyro, accel = slow_chain(values, rate[:, i], force[:, i], t[i], 20.0 + 25.0 * t[i] / END)
        # A value halfway between two steps may be rounded either way.
        assert np.abs(result.gyro[:, i] - gyro).max() < 0.0101
        assert np.mean(np.abs(result.gyro[:, i] - gyro) < 1e-9) > 0.5
        np.testing.assert_allclose(result.accel[:, i], accel, atol=1e-9)


def test_g_sensitivity_responds_to_the_true_force():
    effects = [sized("gyro_g_sensitivity"), sized("accel_bias", x=5.0), sized("accel_scale_factor", x=0.5)]
    np.testing.assert_array_equal(noise_free(effects)[0], noise_free(effects[:1])[0])


def test_effects_are_applied_by_stage_whatever_order_they_are_given_in():
    effects = [sized(name) for name in SENSOR if not name.endswith(("saturation", "quantization"))]
    one, two = noise_free(effects), noise_free(effects[::-1])
    np.testing.assert_allclose(one[0], two[0], atol=1e-12)
    np.testing.assert_allclose(one[1], two[1], atol=1e-12)


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_is_recovered_from_its_coordinates(kind):
    effect = sized(kind.name)
    back = effect.with_coordinates(effect.coordinates())
    assert back.values() == pytest.approx(effect.values())
    assert len(kind.coordinate_scales()) == len(effect.coordinates())
    assert all(isinstance(seed, kind) for seed in kind.initial_guesses())


def test_warm_up_starts_at_power_on():
    late, early = (
        noise_free([GyroWarmup(z=1.0, time_constant=5.0)]),
        noise_free([GyroWarmup(z=1.0, time_constant=5.0)], power_on=-5.0),
    )
    np.testing.assert_allclose(early[0][2, 0] - late[0][2, 0], 1 - np.exp(-1))
    assert late[0][2, 0] == noise_free()[0][2, 0]


def test_a_node_off_the_wheels_goes_through_the_same_chain():
    bench = NodeModel(drive(), np.linspace(0.0, 5.0, 50), NodeMount(), 0.31, 0.92)
    plain, biased = (bench.mean_reading(effects, NodeInitialState()) for effects in ([], [GyroBias(z=0.1)]))
    np.testing.assert_allclose(
        biased.gyro - plain.gyro, [[0.0]] * 2 + [[0.1]] + np.zeros((3, 50)), atol=1e-15
    )


def test_the_table_of_effects_in_the_readme_is_the_list_of_effects():
    readme = Path(__file__).parents[3] / "host/hubodo/model/README.md"
    table = readme.read_text("utf-8").partition("<!-- generated: effects -->")[2].partition("<!-- end")[0]
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \|", table, re.MULTILINE)
    documented = {name: (level, re.findall(r"`(\w+)`", parameters)) for name, level, parameters in rows}
    assert list(documented) == [kind.name for kind in EFFECTS]
    for kind in EFFECTS:
        assert documented[kind.name] == (kind.level, list(kind.parameters())), kind.name
    assert len(BY_NAME) == len(EFFECTS) == 32
