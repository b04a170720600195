"""Tables of a recording: equal columns, increasing time, read-only; events without control characters."""

import pickle

import numpy as np
import pytest

from hubodo.recording import Event, Recording, Table

T = [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"x": T}, "needs a column t"),
        ({"t": T, "x": [1.0]}, "differ in length"),
        ({"t": [0.0, 1.0, 1.0]}, "does not strictly increase"),
    ],
)
def test_an_invalid_table_raises_a_value_error(columns, message):
    with pytest.raises(ValueError, match=message):
        Table(columns)


def test_columns_are_read_only_also_after_pickling():
    for table in (Table({"t": T}), pickle.loads(pickle.dumps(Table({"t": T})))):
        with pytest.raises(ValueError, match="read-only"):
            table.t[0] = 1.0


def test_gyro_and_accel_are_in_the_order_x_y_z():
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    table = Table({"t": T, **{name: np.full(3, k) for k, name in enumerate(names)}})
    assert table.gyro[0].tolist() == [0.0, 1.0, 2.0] and table.accel[0].tolist() == [3.0, 4.0, 5.0]


def test_files_are_the_nodes_then_the_tables():
    recording = Recording({"left": Table({"t": T})}, gnss=Table({"t": T}))
    assert list(recording.files()) == ["left", "gnss"]


def test_control_characters_of_an_event_are_escaped():
    assert "\x1b" not in Event(0, "mark", "left", "red \x1b[31m").text
