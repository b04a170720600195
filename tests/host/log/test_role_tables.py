"""Columns of a role from decoded messages: yaw of quaternions, fixes, wheel speeds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.log.decode import ChannelRows
from hubodo.log.joints import JointSpeeds
from hubodo.log.role_tables import gnss_columns, heading_columns, wheel_speed_columns, yaw_of_quaternions

T0 = 1_700_000_000_000_000_000


def _rows(count: int, **values: np.ndarray) -> ChannelRows:
    t_ns, fields = T0 + np.arange(count), {name.replace("__", "."): array for name, array in values.items()}
    return ChannelRows(np.arange(count), t_ns, t_ns, t_ns, fields, 0)


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=30), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
def test_yaw_is_that_of_the_rotation_whatever_roll_and_pitch_and_has_no_jumps(
    steps: list[float], pitch: float, roll: float
) -> None:
    """Compared with SciPy's rotation matrix: the direction of the x axis, seen from above."""
    yaw = np.cumsum(steps)
    rotation = Rotation.from_euler("ZYX", np.column_stack([yaw, np.full((len(yaw), 2), (pitch, roll))]))
    computed = yaw_of_quaternions(rotation.as_quat())
    x_axis = rotation.as_matrix()[:, :2, 0]
    assert np.column_stack([np.cos(computed), np.sin(computed)]) == pytest.approx(
        x_axis / np.linalg.norm(x_axis, axis=1)[:, None], abs=1e-9
    )
    assert np.diff(computed) == pytest.approx(np.diff(yaw), abs=1e-9)


def test_a_level_rotation_keeps_full_precision_and_its_sign_does_not_matter() -> None:
    yaw = np.array([1e-9, 3.0, 3.3, 6.4])
    quaternions = np.column_stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)])
    assert yaw_of_quaternions(quaternions) == pytest.approx(yaw, rel=1e-12)
    quaternions[2] *= -1.0
    assert yaw_of_quaternions(quaternions) == pytest.approx(yaw, rel=1e-12)


def _fixes(**changes: np.ndarray) -> ChannelRows:
    covariance = np.zeros((4, 9))
    covariance[:, 0], covariance[:, 4], covariance[:, 8] = 1.0, 3.0, 99.0
    values = {
        "latitude": np.array([48.0, 48.1, np.nan, 48.3]),
        "longitude": np.full(4, 11.0),
        "altitude": np.full(4, 500.0),
        "status__status": np.array([0, -1, 0, 2]),
        "position_covariance": covariance,
        "position_covariance_type": np.full(4, 2),
    }
    return _rows(4, **{**values, **changes})


def test_rows_without_a_fix_are_omitted_and_sigma_is_the_horizontal_one() -> None:
    rows, columns = gnss_columns(_fixes())
    assert rows.sequence.tolist() == [0, 3]
    assert columns["latitude_deg"].tolist() == [48.0, 48.3]
    # Root mean square of the variances east and north; the vertical one does not count.
    assert columns["sigma"] == pytest.approx(np.sqrt([2.0, 2.0]))


@pytest.mark.parametrize("kinds", [[0, 0, 0, 0], [2, 2, 2, 0]])
def test_a_single_fix_of_unknown_covariance_leaves_the_table_without_sigma(kinds: list[int]) -> None:
    assert "sigma" not in gnss_columns(_fixes(position_covariance_type=np.array(kinds)))[1]


def test_an_imu_without_orientation_cannot_be_the_heading() -> None:
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    covariance = np.zeros((2, 9))
    covariance[:, 8] = 0.04
    rows = _rows(2, orientation=quaternions, orientation_covariance=covariance)
    assert heading_columns(ros2.IMU, rows, "/imu")["sigma"] == pytest.approx([0.2, 0.2])
    covariance[1, 0] = -1.0
    with pytest.raises(InputError, match=r"/imu: declares that it has no orientation \(covariance -1\)"):
        heading_columns(ros2.IMU, rows, "/imu")


def test_right_is_interpolated_at_the_times_of_left_where_both_were_received() -> None:
    """Times since 1970 in ns, which float64 cannot hold."""
    speeds = JointSpeeds()
    speeds.rows = {
        "l": [(T0 + k * 100, float(k)) for k in range(10)],
        "r": [(T0 + 150 + k * 100, 10.0 + k) for k in range(5)],
    }
    t_ns, columns = wheel_speed_columns(speeds, ("l", "r"), 0.5)
    assert (t_ns - T0).tolist() == [200, 300, 400, 500]
    assert columns["left"].tolist() == [1.0, 1.5, 2.0, 2.5]
    assert columns["right"] == pytest.approx(0.5 * np.array([10.5, 11.5, 12.5, 13.5]))


def test_the_first_and_last_common_time_count() -> None:
    speeds = JointSpeeds()
    speeds.rows = {"l": [(T0 + k, 1.0) for k in range(4)], "r": [(T0 + k, 2.0) for k in range(1, 3)]}
    assert (wheel_speed_columns(speeds, ("l", "r"), 1.0)[0] - T0).tolist() == [1, 2]


def test_wheels_that_were_never_received_together_give_no_rows() -> None:
    speeds = JointSpeeds()
    speeds.rows = {"l": [(T0, 1.0), (T0 + 1, 1.0)], "r": [(T0 + 5, 1.0)]}
    t_ns, columns = wheel_speed_columns(speeds, ("l", "r"), 0.5)
    assert len(t_ns) == len(columns["left"]) == len(columns["right"]) == 0
