"""Short floods of a UDP port beside four nodes on a real recorder; `make faults` runs them at full length."""

import pytest

from faults.floods_udp import flood_of_addresses, flood_of_nodes, flood_of_openings

pytestmark = pytest.mark.real_time


def test_three_hundred_nodes_lose_no_sample_of_the_four_known_ones(tmp_path):
    result = flood_of_nodes(tmp_path, per_second=300)
    assert result.lost == 0 and result.sent > 2000
    assert result.events["refused"] >= 1
    assert result.events["started"] <= 64 + 1, "and the restart"


def test_thousands_of_addresses_lose_no_sample_of_four_nodes_and_need_little_memory(tmp_path):
    result = flood_of_addresses(tmp_path, count=1500, per_second=1000)
    assert result.lost == 0 and result.sent > 2000
    assert result.events["refused"] >= 1, "senders that were dropped are reported"
    assert result.memory_mb < 40


def test_forged_and_replayed_handshakes_keep_no_node_out_and_lose_no_sample(tmp_path):
    result = flood_of_openings(tmp_path, seconds=2)
    assert result.lost == 0 and result.sent > 2000
    assert result.joined_s is not None, "the node that restarts in the middle of the flood gets in"
    assert result.events["refused"] >= 1 and result.events["reset"] == 1
