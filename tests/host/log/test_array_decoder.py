"""The subprocess that decodes MATLAB and HDF5 files."""

import json
import subprocess
import sys

import numpy as np
from scipy.io import savemat

from hubodo.log import array_decoder


def test_each_array_is_a_line_of_json_and_its_float64_values(tmp_path):
    savemat(tmp_path / "x.mat", {"t": np.arange(3.0)})
    order = {"path": str(tmp_path / "x.mat"), "kind": "matlab", "wanted": [], "memory": 1 << 28, "cpu": 30}
    words = [sys.executable, array_decoder.__file__, json.dumps(order)]
    out = subprocess.run(words, capture_output=True, check=True, timeout=100).stdout
    header, _, values = out.partition(b"\n")
    assert json.loads(header) == {"name": "t", "shape": [3], "unit": None, "sent": True}
    assert np.array_equal(np.frombuffer(values), np.arange(3.0))
