"""What becomes of sampling when the chip on the bus is not the one that was set up."""

from types import SimpleNamespace

import pytest
from parts import Parts


class FakeBus:
    """Every chip on it answers with one id."""

    def __init__(self, who_am_i):
        self.who_am_i = who_am_i

    def readfrom_mem_into(self, address, register, one):
        one[0] = self.who_am_i


def look_again(who_am_i):
    """What parts do, in order, with a chip of id 0x69 that lost its settings where `who_am_i` answers now."""
    done = []
    made = object.__new__(Parts)
    made._board = SimpleNamespace(i2c=FakeBus(who_am_i))
    made._sampler = SimpleNamespace(end=lambda: done.append("sampling ends"))
    made.chip = SimpleNamespace(
        address=0x6B,
        WHO_AM_I_REGISTER=0x0F,
        who_am_i=0x69,
        intact=lambda: False,
        configure=lambda: done.append("set up"),
    )
    made.i2c_errors = 0
    made._search = lambda: done.append("search")
    made.begin = lambda lost: done.append(("sampling begins", lost))
    assert made._revive(False)
    return done, made.i2c_errors


@pytest.mark.parametrize(
    ("who_am_i", "done", "errors"),
    [(0x69, ["set up", ("sampling begins", True)], 1), (0x6C, ["sampling ends", "search"], 0)],
)
def test_the_same_chip_is_set_up_again_and_of_another_no_sample_is_taken(who_am_i, done, errors):
    assert look_again(who_am_i) == (done, errors)
