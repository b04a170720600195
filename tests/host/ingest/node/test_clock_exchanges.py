"""Clock requests to a node: schedule, and matching of replies."""

from hubodo.ingest.node.clock_exchanges import ClockExchanges
from hubodo.units import NS_PER_S


def test_tokens_are_printable_and_unique():
    """Ctrl-C stops a booting board; nodes 1 and 2 receive each other's requests."""
    nodes = [ClockExchanges(node, NS_PER_S) for node in (1, 2)]
    tokens = [node.next_token() for node in nodes for _ in range(5000)]
    assert len(set(tokens)) == len(tokens)
    assert all(len(token) == 8 and min(token) >= 0x20 and max(token) < 0x7F for token in tokens)


def test_a_burst_at_the_start_then_one_a_period():
    asked = ClockExchanges(1, NS_PER_S)
    asked.start_burst()
    times = [ms for ms in range(4000) if asked.is_due(ms * NS_PER_S // 1000)]
    assert times == [*range(0, 160, 20), 1140, 2140, 3140]


def test_an_answer_matches_its_request_once_and_the_oldest_requests_are_dropped():
    asked = ClockExchanges(1, NS_PER_S)
    tokens = [asked.next_token() for _ in range(40)]
    for t, token in enumerate(tokens):
        asked.add_request(token, t)
    sent_ns = [asked.match_reply(token) for token in tokens]
    assert sent_ns == [None] * 8 + list(range(8, 40))
    assert asked.match_reply(tokens[-1]) is None
