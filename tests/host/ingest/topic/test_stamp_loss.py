"""Lost messages by the intervals of stamps, on streams with known losses."""

import numpy as np
import pytest

from hubodo.ingest.topic.stamp_loss import StampLoss


def count_lost(stamps_ns):
    loss = StampLoss()
    return sum(loss.add_interval(int(interval)) for interval in np.diff(stamps_ns))


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_losses_of_a_regular_topic_are_counted(share, jitter):
    random = np.random.default_rng(4)
    stamps = 5e6 * (np.arange(4000) + jitter * random.uniform(-1, 1, 4000))
    received = random.uniform(size=4000) >= share
    received[:40] = received[-1] = True
    assert count_lost(stamps[received]) == pytest.approx(np.count_nonzero(~received), rel=0.1)


@pytest.mark.parametrize("size", [2, 4, 8, 10])
def test_batches_stamped_on_arrival_are_no_losses(size):
    numbers = np.arange(4000)
    stamps = 5e6 * size * (numbers // size) + 1e5 * (numbers % size)
    assert count_lost(stamps) == 0


def test_an_outage_is_counted_by_its_duration():
    stamps = 5e6 * np.concatenate([np.arange(200), np.arange(600, 700)])
    assert count_lost(stamps) == 400
