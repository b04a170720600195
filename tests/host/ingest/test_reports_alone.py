"""A node that sends reports and no samples, and answers no question about its clock."""

import pytest

from faults.line import T0, Line, Node
from hubodo.units import NS_PER_S
from hubowire.messages import Filter, Health

PERIOD = 1 << 30


def health(t_us, battery_mv=3700):
    return Health(t_us, battery_mv, 0, 0, 0, 0, 0, 0, 0, 1, 900, 1, 50_000, 40)


class Stamped(Line):
    """A line that keeps the times of batteries and filter reports."""

    def __init__(self):
        super().__init__()
        self.sink.times = []
        self.sink.write_battery = lambda node, t_pub_ns, *_: self.sink.times.append(int(t_pub_ns[0]))
        self.sink.write_bias_filter = lambda node, t_pub_ns, *_: self.sink.times.append(int(t_pub_ns[0]))


def test_its_battery_is_stamped_when_it_was_received_not_in_1970():
    line, node = Stamped(), Node()
    line.says(node.says_hello())
    for second in range(3):
        line.says(node.frame(health(second * 1_000_000)), seconds=1.0)
    line.close()
    assert line.sink.times == pytest.approx([T0 + k * NS_PER_S for k in range(3)], abs=0.1 * NS_PER_S)


@pytest.mark.parametrize(
    "last", [Filter(PERIOD - 1, 2, 0, 9, (1, 0, 0), (0, 0, 0), (1, 0, 1), (4, 4, 8)), None]
)
def test_microseconds_that_turn_over_give_no_negative_time(last):
    line, node = Stamped(), Node()
    line.says(node.says_hello())
    line.says(node.frame(health(0)), seconds=1.0)
    line.says(node.frame(last or health(PERIOD - 1)), seconds=1.0)
    line.says(node.frame(health(2_000_000)), seconds=1.0)
    sink = line.close()
    assert "fault" not in sink.kinds()
    assert len(sink.times) == 3
    assert all(abs(t_ns - T0) < 10 * NS_PER_S for t_ns in sink.times)
