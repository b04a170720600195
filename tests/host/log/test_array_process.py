"""MATLAB files decoded in a subprocess."""

import numpy as np
import pytest
from scipy.io import savemat

from hubodo.errors import InputError
from hubodo.log.array_process import read_isolated


def test_selected_arrays_are_read_and_of_the_others_only_the_shape(tmp_path):
    gyro = np.random.default_rng(1).normal(size=(50, 3))
    savemat(tmp_path / "x.mat", {"imu": {"gyro": gyro, "count": 7}, "note": "text", "t": np.arange(50.0)})
    arrays, units = read_isolated(tmp_path / "x.mat", "matlab", ("imu.gyro",))
    assert np.array_equal(arrays["imu.gyro"], gyro) and units == {}
    assert arrays["t"].shape == (50, 1) and not arrays["t"].any()
    assert set(arrays) == {"imu.gyro", "t"}


def test_a_damaged_file_is_an_error_with_its_name(tmp_path):
    savemat(tmp_path / "x.mat", {"t": np.arange(5000.0)})
    (tmp_path / "y.mat").write_bytes((tmp_path / "x.mat").read_bytes()[:4000])
    with pytest.raises(InputError, match=r"y\.mat: .*save it again"):
        read_isolated(tmp_path / "y.mat", "matlab", ())
