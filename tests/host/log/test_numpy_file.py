"""Arrays in .npy and .npz files."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.numpy_file import read_numpy


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_selected_arrays_are_read_and_of_the_others_only_the_shape(save, tmp_path):
    gyro = np.arange(30, dtype=np.int16).reshape(10, 3)
    save(tmp_path / "x.npz", gyro=gyro, t=np.arange(10.0), label=np.array("text"))
    arrays, _ = read_numpy(tmp_path / "x.npz", ("gyro",))
    assert np.array_equal(arrays["gyro"], gyro) and arrays["gyro"].dtype == np.float64
    assert arrays["t"].shape == (10, 1) and set(arrays) == {"gyro", "t"}


def test_a_header_that_claims_more_than_the_file_has_and_objects_are_refused(tmp_path):
    np.save(tmp_path / "x.npy", np.arange(1000.0))
    (tmp_path / "cut.npy").write_bytes((tmp_path / "x.npy").read_bytes()[:-8])
    with pytest.raises(InputError, match="claims 1000 numbers"):
        read_numpy(tmp_path / "cut.npy", ())
    np.save(tmp_path / "objects.npy", np.array([{}], object))
    with pytest.raises(InputError, match="Python objects"):
        read_numpy(tmp_path / "objects.npy", ())
