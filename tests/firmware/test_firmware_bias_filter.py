"""The integer Kalman filter agrees with the published filter, and the static initialisation is exact."""

import math
from array import array

import bias_filter
import native
import numpy as np
import pytest
import static_init
import wire
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import lfilter
from small_int import SmallInt

from repetitions import first_and_more

N_HOUR = 749_000
N_MINUTES = 150_000
ROW_SIZE = 6
GAIN_RATE, GAIN_BIAS = 314_573, 322


def rows(*axes):
    """Return samples in the layout of a slot: gyro axes followed by a static accelerometer."""
    table = np.zeros((len(axes[0]), ROW_SIZE), dtype=np.int64)
    for i, axis in enumerate(axes):
        table[:, i] = np.clip(np.round(axis), -32768, 32767)
    table[:, 5] = 2049
    return table


def float_filter(z, gain_rate_q20, gain_bias_q30, bias=0.0):
    """Return (rate, bias) after each sample in float64: eq. 10-11 with the same two gains.

    Both are a gain times the sum of all residuals, which is a first-order filter.
    """
    rate_gain, bias_gain = gain_rate_q20 / 2**20, gain_bias_q30 / 2**30
    residuals = lfilter([1.0], [1.0, rate_gain + bias_gain - 1.0], z - bias)
    return np.column_stack([rate_gain * residuals, bias + bias_gain * residuals])


def run_integer_filter(table, gain_rate, gain_bias, chunk, bias_q14=(0, 0, 0)):
    """Run the integer filter; yield (number of samples, estimator) after each chunk."""
    estimator = bias_filter.KalmanFilter(gain_rate, gain_bias)
    for axis in range(3):
        estimator.reset(axis, bias_q14[axis])
    for start in range(0, len(table), chunk):
        part = table[start : start + chunk]
        estimator.update(part.reshape(-1).tolist(), 0, len(part))
        yield start + len(part), estimator


def state(estimator, axis):
    """Return (rate, bias) in gyro steps, with all bits of the state."""
    rate, rate_rest, bias, bias_rest, *_ = estimator._axes[axis]
    return rate / 2**4 + rate_rest / 2**24, bias / 2**14 + bias_rest / 2**34


def hour_of_signals(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(N_HOUR) / 208.0
    still = 11.4 + rng.normal(0, 1.5, N_HOUR)
    speed = 9000 * (1 - np.cos(2 * math.pi * t / 140.0)) + 1500 * np.sin(2 * math.pi * t / 7.3)
    drive = speed + 11.4 + 0.004 * t + rng.normal(0, 1.5, N_HOUR)
    saturating = 50_000 * np.sin(2 * math.pi * t / 23.0) + rng.normal(0, 1.5, N_HOUR)
    random_steps = np.repeat(rng.choice([-32768, 32767, 0, 1, -1], N_HOUR // 50 + 1), 50)[:N_HOUR]
    full_swing = np.where(np.arange(N_HOUR) % 2, 32767, -32768)
    one_sided = np.full(N_HOUR, 32767)
    return rows(still, drive, saturating), rows(random_steps, full_swing, one_sided)


@pytest.fixture(scope="module")
def hour_of_samples():
    """Return the signals of seed 7."""
    return hour_of_signals(7)


@pytest.mark.parametrize(
    ("table_index", "gain_rate", "gain_bias", "samples"),
    [
        (0, GAIN_RATE, GAIN_BIAS, N_MINUTES),
        pytest.param(0, GAIN_RATE, GAIN_BIAS, N_HOUR, marks=pytest.mark.repeat),
        (1, GAIN_RATE, GAIN_BIAS, N_MINUTES),
        (0, 5000, bias_filter.GAIN_LIMIT - 1, N_MINUTES),
    ],
    ids=["still, drive, saturating", "an hour of them", "steps, full swing, constant", "largest bias gain"],
)
def test_many_samples_stay_within_a_tenth_of_a_step_of_float64(
    hour_of_samples, table_index, gain_rate, gain_bias, samples
):
    table = hour_of_samples[table_index][:samples]
    expected = [float_filter(table[:, axis], gain_rate, gain_bias) for axis in range(3)]
    counts, states = [], []
    for count, estimator in run_integer_filter(table, gain_rate, gain_bias, 15):
        counts.append(count)
        states.append([state(estimator, axis) for axis in range(3)])
    error = np.abs(np.array(states) - np.stack(expected, axis=1)[np.array(counts) - 1])
    worst = error.max(axis=0)
    print(f"seed 7: worst difference (rate, bias) by axis in steps: {worst.tolist()}")
    assert worst.max() <= 1 / 32 + 2**-13, "the error bound stated in bias_filter.py"
    assert worst.max() <= 0.1
    assert estimator.saturations == 0


def test_reported_rate_and_bias_are_those_of_the_state(hour_of_samples):
    table = hour_of_samples[0][:5000]
    *_, (_, estimator) = run_integer_filter(table, GAIN_RATE, GAIN_BIAS, 8)
    for axis in range(3):
        rate, bias = state(estimator, axis)
        assert 0 <= rate - estimator.rate_q8(axis) / 256 < 1 / 256
        assert 0 <= bias - estimator.bias_q12(axis) / 4096 < 1 / 4096 + 2**-14


SAMPLES = st.integers(-32768, 32767) | st.sampled_from([-32768, -32767, -1, 0, 1, 32766, 32767])
GAINS = st.integers(0, bias_filter.GAIN_LIMIT - 1) | st.sampled_from([0, 1, bias_filter.GAIN_LIMIT - 1])


@settings(max_examples=60)
@given(
    st.lists(st.tuples(SAMPLES, SAMPLES, SAMPLES), min_size=1, max_size=120),
    GAINS,
    GAINS,
    st.integers(-(1 << 28), 1 << 28),
    st.integers(1, 255),
)
def test_no_intermediate_needs_more_than_31_bits(samples, gain_rate, gain_bias, bias_q14, repeat):
    estimator = bias_filter.KalmanFilter(gain_rate, gain_bias)
    for axis in range(3):
        estimator.reset(axis, bias_q14)
    # Lists instead of int32 arrays, so that the state consists of SmallInt too.
    estimator._axes = [[SmallInt(value) for value in axis] for axis in estimator._axes]
    flat = [SmallInt(value) for row in samples for value in (*row, 0, 0, 0)]
    for _ in range(3):
        estimator.update(flat, 0, len(samples))
    estimator.update(flat[:ROW_SIZE] * repeat, 0, repeat)
    for axis in range(3):
        estimator.rate_q8(axis)
        estimator.bias_q12(axis)


def test_a_residual_beyond_its_format_is_clipped_and_counted():
    estimator = bias_filter.KalmanFilter(bias_filter.GAIN_LIMIT - 1, bias_filter.GAIN_LIMIT - 1)
    for axis in range(3):
        estimator.reset(axis, 1 << 28)
    swing = [32767, -32768, 0, 0, 0, 0, -32768, 32767, 0, 0, 0, 0]
    for _ in range(2000):
        estimator.update(swing, 0, 2)
    assert estimator.saturations > 0
    assert all(abs(estimator.bias_q12(axis)) <= 1 << 27 for axis in range(3))


@pytest.mark.parametrize(
    ("k1", "k2", "period"), [(60.0, 2e-4, 1 / 208), (3.0, 0.05, 1 / 416), (400.0, 0.3, 1 / 104)]
)
def test_the_closed_form_equals_the_matrix_exponential_of_the_paper(k1, k2, period):
    """Compare with eq. 10, integrating exp(-m t) by an augmented matrix exponential (Van Loan 1978)."""
    m = np.array([[k1, k1], [k2, k2]])
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[:2, 2] = -m, (k1, k2)
    transition = expm(augmented * period)
    scale = (1 - math.exp(-(k1 + k2) * period)) / (k1 + k2)
    z = np.random.default_rng(11).normal(300, 40, 400)
    paper, closed_form = np.zeros(2), np.zeros(2)
    for sample in z:
        paper = transition[:2, :2] @ paper + transition[:2, 2] * sample
        closed_form = closed_form + np.array([k1, k2]) * scale * (sample - closed_form.sum())
    np.testing.assert_allclose(closed_form, paper, rtol=1e-9)


@settings(max_examples=60)
@given(st.lists(SAMPLES, min_size=1, max_size=60), GAINS, GAINS, st.integers(-(1 << 28), 1 << 28))
def test_the_native_filter_gives_the_same_bits(samples, gain_rate, gain_bias, bias_q14):
    fast = native.load()
    words = array("h", [value for sample in samples for value in (sample, 0, 0, 0, 0, 0)])
    states = [array("i", (0, 0, bias_q14, 0, gain_rate, gain_bias)) for _ in range(2)]
    clipped = bias_filter.kalman_plain(words, 0, len(words), states[0])
    unsigned = array("H", words.tobytes())
    assert fast.kalman(unsigned, 0, len(words), states[1]) == clipped
    assert states[0] == states[1]


def run_static_init(samples, values, limits=(70_000_000, 488_000), check=lambda value: value):
    static = static_init.StaticInit()
    static.start(check(samples), check(limits[0]), check(limits[1]))
    flat = [check(int(value)) for value in np.asarray(values).reshape(-1)]
    ended = False
    for start in range(0, len(flat), 8 * ROW_SIZE):
        ended = static.update(flat, start, min(8, (len(flat) - start) // ROW_SIZE))
        if ended:
            break
    return static, ended


def static_samples(n, seed, bias=(12.3, -40.0, 3.7)):
    rng = np.random.default_rng(seed)
    table = rows(*(b + rng.normal(0, 1.7, n) for b in bias))
    table[:, 3:] = np.round(rng.normal((0, 700, 1900), 3.0, (n, 3)))
    return table


@pytest.mark.parametrize("n", [2000, 4096, 65535])
def test_static_bias_and_variance_are_mean_and_variance_of_the_samples(n):
    table = static_samples(n, seed=n)
    static, ended = run_static_init(n, table)
    assert ended and static.state == wire.FILTER_STATE_TRACKING and static.samples == n
    for axis in range(3):
        assert 0 <= table[:, axis].mean() - static.bias_q14[axis] / 2**14 < 2**-14
        assert static.variance_q8[axis] / 256 == pytest.approx(table[:, axis].var(), abs=0.2)
        sigma = table[:, axis].std() / math.sqrt(n)
        assert static.sigma_q12[axis] / 4096 == pytest.approx(sigma, rel=0.05, abs=2**-12)


def test_samples_without_noise_give_a_bias():
    table = np.tile([5, -5, 0, 0, 700, 1900], (2000, 1))
    static, ended = run_static_init(2000, table)
    assert ended and static.bias_q14 == [5 << 14, -5 << 14, 0]
    assert static.sigma_q12 == [0, 0, 0] and static.variance_q8 == [0, 0, 0]


@pytest.mark.parametrize("first", [-6000, 6000])
def test_the_sums_are_exact_with_small_steps_and_an_outlier_as_first_sample(first):
    """Squares have 25 bits and sums two words (range 125 deg/s, step 0.004 deg/s, noise 0.7 deg/s)."""
    n = 4097
    table = rows(*(np.random.default_rng(axis).normal(0, 150.0, n) for axis in range(3)))
    table[0, :3] = first
    static, ended = run_static_init(n, table, (4_375_000, 61_000))
    assert ended and static.state == wire.FILTER_STATE_TRACKING
    for axis in range(3):
        assert 0 <= table[:, axis].mean() - static.bias_q14[axis] / 2**14 < 2**-14
        # The mean is rounded to 2^-8 steps, which twice the offset of 6000 steps multiplies.
        assert static.variance_q8[axis] / 256 == pytest.approx(table[:, axis].var(), abs=2 * 6000 / 256 + 1)


def constant_samples():
    return np.tile([0.0, 0.0, 0.0, 0.0, 700.0, 1900.0], (2000, 1))


def alternating_samples(column, size):
    """Return samples that alternate around the mean."""
    table = constant_samples()
    table[1:, column] += np.trunc(np.resize([size, -size], 1999))
    return table


def rotating_samples(size, first):
    """Return a constant rate about the third axis, with another first sample."""
    table = constant_samples()
    table[:, 2] = size
    table[0, 2] = first
    return table


def samples_with_outlier(column, size):
    """Return static samples with a single outlier."""
    table = constant_samples()
    table[1000, column] = size
    return table


@pytest.mark.parametrize(
    ("samples_for", "bound"),
    [
        (lambda by: alternating_samples(1, 1.0 / 0.07 * by), "1 deg/s"),
        (lambda by: alternating_samples(4, 20.0 / 0.488 * by), "0.02 g"),
        (lambda by: rotating_samples(30.0 / 0.07 * by, 30.0 / 0.07 * by), "a mean of 30 deg/s"),
        (lambda by: rotating_samples(-30.0 / 0.07 * by, -30.0 / 0.07 * by), "of -30"),
        (lambda by: rotating_samples(30.0 / 0.07 * by, 26.0 / 0.07), "of 30, and first of 26"),
        (lambda by: samples_with_outlier(0, 30.0 / 0.07 * by), "once 30 deg/s more than at first"),
        (lambda by: samples_with_outlier(0, -30.0 / 0.07 * by), "once 30 deg/s less"),
        (lambda by: samples_with_outlier(3, 500.0 / 0.488 * by), "once 0.5 g more than at first"),
        (lambda by: samples_with_outlier(3, -500.0 / 0.488 * by), "once 0.5 g less"),
    ],
)
def test_standstill_is_accepted_up_to_each_bound_and_refused_beyond(samples_for, bound):
    """Bounds are rounded down to whole steps: 1 deg/s becomes 14 steps of 0.07 deg/s, 0.98 deg/s."""
    refusals = [run_static_init(2000, np.trunc(samples_for(by)))[0].refused for by in (0.94, 1.09)]
    assert refusals == [0, wire.REASON_WHEEL_TURNS], bound


@pytest.mark.parametrize("first", [-380, -365, 365, 380])
def test_standstill_is_accepted_with_an_outlier_as_first_sample(first):
    """The variance including the first sample, as numpy computes it, is below (1 deg/s)^2."""
    noise = np.random.default_rng(3).normal(0.0, 1.0, 2000)
    table = static_samples(2000, seed=7, bias=(0.0, 0.0, 0.0))
    table[:, 1] = np.round(9.0 * noise + 0.49)
    table[0, 1] = first
    assert 0.8 < np.std(table[:, 1]) * 0.07 < 0.95
    static, _ = run_static_init(2000, table)
    assert static.refused == 0
    assert static.bias_q14[1] / 2**14 == pytest.approx(table[:, 1].mean(), abs=2**-14)


def samples_of_turning_wheel(n, kind):
    table = static_samples(n, seed=5)
    angle = np.linspace(0, 0.5, n)
    if kind == "slowly, with gravity":
        table[:, 3] = np.round(2049 * np.sin(angle))
        table[:, 4] = np.round(2049 * np.cos(angle))
    elif kind == "steadily":
        table[:, 2] += 800
    elif kind == "to and fro":
        table[:, 0] += np.round(40 * np.sin(np.arange(n) / 30)).astype(int)
    elif kind == "in one jerk":
        table[n // 2, 1] = 3000
    return table


@pytest.mark.parametrize("kind", ["slowly, with gravity", "steadily", "to and fro", "in one jerk"])
def test_a_turning_wheel_is_refused_and_the_bias_unchanged(kind):
    static, ended = run_static_init(2000, samples_of_turning_wheel(2000, kind))
    assert ended and static.refused == wire.REASON_WHEEL_TURNS
    assert static.state == wire.FILTER_STATE_WAITING
    assert static.bias_q14 == [0, 0, 0] and static.samples == 0


@pytest.mark.parametrize(
    "limits", first_and_more(((4_375_000, 61_000),), ((7_633_588, 61_035),), ((70_000_000, 488_281),))
)
@pytest.mark.parametrize("n", [2000, 65535])
def test_the_sums_of_the_initialisation_fit_31_bits(limits, n):
    gyro_limit, accel_limit = 1_000_000_000 // limits[0] * 30, 500_000_000 // limits[1]
    row = [SmallInt(value) for value in (*[-gyro_limit] * 3, *[accel_limit] * 3)]
    static = static_init.StaticInit()
    static.start(SmallInt(n), SmallInt(limits[0]), SmallInt(limits[1]))
    static.update([0] * ROW_SIZE, 0, 1)
    # All sums except the low words of the squares only grow: they are largest in the last thousand samples.
    n_checked = 1000
    static.update([int(value) for value in row] * (n - 1 - n_checked), 0, n - 1 - n_checked)
    for name in ("_sum", "_square_high", "_square_low", "_reference", "_limit", "_variance_limit"):
        setattr(static, name, [SmallInt(value) for value in getattr(static, name)])
    static._count, static._wanted = SmallInt(static._count), SmallInt(static._wanted)
    assert static.update(row * n_checked, 0, n_checked), "the initialisation has ended without an overflow"


def test_half_of_the_warm_up_during_the_initialisation_is_added_to_the_mean():
    """The bias rises by three steps: the mean is that of the middle, the result must be that of the end."""
    n = 4096
    rise = np.linspace(0.0, 3.0, n)
    rng = np.random.default_rng(1)
    flat = rows(*(20 + rise + rng.normal(0, 1.0, n) for _ in range(3))).reshape(-1).tolist()
    static = static_init.StaticInit()
    static.start(n, 70_000_000, 488_000)
    for at in range(0, len(flat), 8 * ROW_SIZE):
        for axis in range(3):
            static.drift(axis, round(3.0 / (n / 8) * 2**18))
        ended = static.update(flat, at, 8)
    assert ended
    estimated = [static.bias_q14[axis] / 2**14 for axis in range(3)]
    assert estimated == pytest.approx([23.0] * 3, abs=4 / math.sqrt(n))
    static.drift(0, 1 << 17)
    assert static.now_q14(0) - static.bias_q14[0] == 1 << 13, "after the end all of the warm-up is added"


def test_the_warm_up_changes_the_bias_and_not_the_rate():
    estimator = bias_filter.KalmanFilter(GAIN_RATE, GAIN_BIAS)
    estimator.reset(1, 5 << 14)
    steps = [7, -3, 1 << 20, -(1 << 19), 123_457]
    for step in steps:
        estimator.drift(1, step)
    rate, bias = state(estimator, 1)
    assert rate == 0.0 and bias == 5 + sum(steps) / 2**18
