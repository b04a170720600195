"""A dialogue with one node: identification, answers, refusals, silence and restart."""

from collections import Counter
from collections.abc import Callable, Iterator

import pytest

from fakes.node_messages import health, hello
from hubodo.errors import InputError, LinkError, WireMismatch
from hubodo.ingest.link.open_link import LinkDown
from hubodo.ingest.link.ports import parse_port
from hubodo.ingest.node import conversation
from hubodo.ingest.node.conversation import Conversation, NodeRefused
from hubowire import Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import Ack, GetHello, Nack, Ping, Reason, RebootMode

Reply = Callable[[Frame], list[Message]]


class FakeLink:
    """A link whose nodes answer requests by `reply` and have sent `first` before.

    From a None in `first` on, the link is unplugged.
    """

    endpoint, datagrams = "/dev/ttyFAKE", False

    def __init__(self, reply: Reply, *first: tuple[int, Message] | bytes | None) -> None:
        self.refused: Counter[str] = Counter()
        self.requests: list[Message | None] = []
        self.nodes = {item[0] for item in first if isinstance(item, tuple)}
        self.closed = False
        self._reply, self._output = reply, list(first)
        self._decoder = FrameDecoder()

    def read(self, timeout: float) -> tuple[bytes, str]:
        if not self._output:
            CLOCK.sleep(timeout)
            return b"", ""
        if self._output[0] is None:
            raise LinkDown("/dev/ttyFAKE: unplugged")
        item = self._output.pop(0)
        if isinstance(item, bytes):
            return item, ""
        node, message = item
        return b"\0" + encode_frame(Frame(message.type_id, node, 0, encode(message))), ""

    def write(self, data: bytes, to: str = "") -> None:
        for frame in self._decoder.feed(data):
            self.requests.append(decode(frame.type_id, frame.payload))
            for node in sorted(self.nodes):
                self._output += [(node, message) for message in self._reply(frame)]

    def close(self) -> None:
        self.closed = True


class VirtualTime:
    """The clock of the dialogue: reading an idle link takes the whole timeout, everything else no time."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


CLOCK = VirtualTime()


@pytest.fixture(autouse=True)
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let silence cost a test no time."""
    monkeypatch.setattr(conversation, "time", CLOCK)


def _open(
    monkeypatch: pytest.MonkeyPatch, *links: FakeLink | LinkError, node_id: int | None = None
) -> Conversation:
    """Return a dialogue on the first link; the others follow when the port is opened again."""
    remaining: Iterator[FakeLink | LinkError] = iter(links)

    def open_transport(*_: object) -> FakeLink:
        link = next(remaining)
        if isinstance(link, LinkError):
            raise link
        return link

    monkeypatch.setattr(conversation, "open_transport", open_transport)
    return Conversation(parse_port("/dev/ttyFAKE"), 115200, node_id)


def _identify(frame: Frame) -> list[Message]:
    return [hello()] if frame.type_id == GetHello.type_id else [Ack(frame.type_id, frame.seq)]


def _silent(frame: Frame) -> list[Message]:
    return []


def test_a_node_is_asked_for_its_hello_after_its_first_frame_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may be sent to a board during its boot."""
    link = FakeLink(_identify, (1, health()))
    with _open(monkeypatch, link) as dialogue:
        assert dialogue.identify() == hello()
        assert (dialogue.node_id, dialogue.health) == (1, health())
    assert link.requests == [GetHello()] and link.closed
    silent = FakeLink(_identify)
    with _open(monkeypatch, silent) as dialogue, pytest.raises(LinkError, match="no data for 4 s"):
        dialogue.identify()
    assert silent.requests == []


@pytest.mark.parametrize(
    ("first", "node_id", "error", "message"),
    [
        (
            [(1, health()), (2, health())],
            None,
            InputError,
            r"nodes 1 \(left\), 2 \(right\) are present; .* --node-id",
        ),
        ([(2, health())], 1, LinkError, "node 1 is not received; received: 2"),
        ([b"$GPGGA,1,2,3\r\n"], None, LinkError, "NMEA text of a GNSS receiver; give this port with --gnss"),
    ],
)
def test_without_a_single_node_the_error_names_what_was_received(
    monkeypatch: pytest.MonkeyPatch,
    first: list[tuple[int, Message] | bytes],
    node_id: int | None,
    error: type[Exception],
    message: str,
) -> None:
    link = FakeLink(_identify, *first)
    with _open(monkeypatch, link, node_id=node_id) as dialogue, pytest.raises(error, match=message):
        dialogue.identify()
    assert link.requests == []


def test_of_several_nodes_the_chosen_one_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    link = FakeLink(_identify, (1, health(battery_mv=3000)), (2, health(battery_mv=4000)))
    with _open(monkeypatch, link, node_id=2) as dialogue:
        dialogue.identify()
        assert dialogue.health is not None and dialogue.health.battery_mv == 4000


def test_a_node_of_another_message_table_is_refused_with_both_fingerprints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = FakeLink(lambda frame: [hello(fingerprint=0xABCDEF01)], (1, health()))
    with (
        _open(monkeypatch, link) as dialogue,
        pytest.raises(WireMismatch, match=r"speaks abcdef01 \(firmware 1\.4\.2\)"),
    ):
        dialogue.identify()


def test_a_request_is_repeated_until_it_is_acknowledged(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def reply(frame: Frame) -> list[Message]:
        if frame.type_id == GetHello.type_id:
            return [hello()]
        calls.append(frame.seq)
        # The first answer belongs to another request.
        return (
            [Ack(frame.type_id, (frame.seq + 77) & 0xFFFF)]
            if len(calls) < 3
            else [Ack(frame.type_id, frame.seq)]
        )

    with _open(monkeypatch, FakeLink(reply, (1, health()))) as dialogue:
        dialogue.identify()
        dialogue.request(Ping())
    assert len(calls) == len(set(calls)) == 3


def test_silence_after_a_request_is_an_error_that_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    link = FakeLink(_silent, (1, health()))
    with _open(monkeypatch, link) as dialogue:
        with pytest.raises(LinkError, match="sends frames but does not answer; unplug it"):
            dialogue.identify()
        with pytest.raises(LinkError, match="no answer to Ping"):
            dialogue.request(Ping(), attempts=2)
    assert link.requests == [GetHello()] * 3 + [Ping()] * 2


@pytest.mark.parametrize(
    ("reason", "error", "text"),
    [
        (Reason.BAD_VALUE, InputError, r"the node refuses Ping: invalid value \(7\)"),
        (Reason.BUSY, NodeRefused, "it is busy with an initialisation"),
        (99, NodeRefused, "reason 99, unknown to this host"),
    ],
)
def test_a_refused_value_is_invalid_input_and_any_other_refusal_is_not(
    monkeypatch: pytest.MonkeyPatch, reason: int, error: type[Exception], text: str
) -> None:
    link = FakeLink(lambda frame: [Nack(frame.type_id, frame.seq, reason, 7)], (1, health()))
    with _open(monkeypatch, link, node_id=1) as dialogue, pytest.raises(error, match=text):
        dialogue.request(Ping())


def test_a_restart_ends_with_the_hello_of_another_boot_on_a_port_opened_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = FakeLink(_identify, (1, health()), None)
    after = FakeLink(_identify, (1, hello()), (1, hello(boot_id=4712)))
    with _open(monkeypatch, before, LinkError("no such device"), after, node_id=1) as dialogue:
        dialogue.restart_node(RebootMode.RUN)
        assert dialogue.wait_for_restart(5.0, 4711).boot_id == 4712
    assert before.closed and after.closed


def test_a_node_that_does_not_come_back_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    link = FakeLink(_identify, (1, hello()))
    with (
        _open(monkeypatch, link, node_id=1) as dialogue,
        pytest.raises(LinkError, match="no Hello 9 s after the restart; see `hubodo doctor`"),
    ):
        dialogue.wait_for_restart(9.0, 4711)
