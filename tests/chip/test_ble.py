"""A row of the table of `make ble`, so that it runs with the present air and host."""

import pytest

from ble_rides import SETTLED_S, ride
from hubodo.emulator.chips.ble_link import BleConditions


@pytest.mark.repeat
def test_two_nodes_at_416_hz_lose_no_frame_at_the_slowest_interval_of_bluez():
    seconds = SETTLED_S + 2.0
    run = ride(BleConditions(interval=0.05), seconds=seconds, seed=1)
    assert [run.lost(k) for k in run.streams] == [0, 0]
    assert all(len(stream.after(SETTLED_S)) > 30 for stream in run.streams.values())
