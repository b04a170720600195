"""The raw prompt of MicroPython on a port: order of bytes, errors of the board, and silence."""

from collections.abc import Callable

import pytest

from hubodo.flash import prompt
from hubodo.flash.prompt import NEXT_CHUNK, FlashError, RawPrompt

READY = b"raw REPL; CTRL-B to exit\r\n>"


class FakeBoard:
    """A board at its raw prompt; answer: what it sends for the bytes written since its last answer."""

    port = "/dev/ttyFAKE"

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self._answer, self._unanswered, self._output = answer, b"", b""
        self.writes: list[bytes] = []

    @property
    def in_waiting(self) -> int:
        return len(self._output)

    def write(self, data: bytes) -> None:
        self.writes.append(data)
        self._unanswered += data
        answer = self._answer(self._unanswered)
        if answer:
            self._output, self._unanswered = self._output + answer, b""

    def read(self, size: int) -> bytes:
        # A slow line gives one byte at a time, so that each terminator is split.
        data, self._output = self._output[:1], self._output[1:]
        return data


def _runs(printed: bytes, raised: bytes = b"") -> FakeBoard:
    return FakeBoard(
        lambda data: b"OK" + printed + b"\x04" + raised + b"\x04>" if data.endswith(b"\x04") else b""
    )


def test_entering_interrupts_the_program_and_waits_for_the_prompt() -> None:
    board = FakeBoard(lambda data: b"Traceback ...\r\n" + READY if data == b"\r\x03\x01" else b"")
    assert RawPrompt(board).enter(5.0)  # type: ignore[arg-type]


def test_a_board_that_does_not_answer_is_not_at_the_prompt() -> None:
    assert not RawPrompt(FakeBoard(lambda data: b"")).enter(0.01)  # type: ignore[arg-type]


def test_the_output_of_the_code_is_returned_completely() -> None:
    raw = RawPrompt(_runs("1\r\nz\u00fcrich\r\n".encode()))  # type: ignore[arg-type]
    assert raw.run("print(1)") == "1\r\nz\u00fcrich\r\n"
    # The next run starts with an empty buffer.
    assert raw.run("print(1)") == "1\r\nz\u00fcrich\r\n"


def test_an_exception_on_the_board_is_an_error_with_port_and_last_line() -> None:
    raised = b"Traceback (most recent call last):\r\n  File x\r\nOSError: [Errno 28] ENOSPC\r\n"
    with pytest.raises(FlashError, match=r"^/dev/ttyFAKE: OSError: \[Errno 28\] ENOSPC$"):
        RawPrompt(_runs(b"", raised)).run("x")  # type: ignore[arg-type]


def test_long_code_is_sent_in_chunks_that_a_uart_buffer_holds() -> None:
    board, code = _runs(b""), "x = 1\n" * 200
    RawPrompt(board).run(code)  # type: ignore[arg-type]
    assert b"".join(board.writes) == code.encode() + b"\x04"
    assert max(map(len, board.writes)) <= 256


def test_each_request_of_the_board_is_answered_with_the_next_piece() -> None:
    pieces = [b"aa", b"bb", b"cc"]

    def answer(data: bytes) -> bytes:
        if data.endswith(b"\x04"):
            return b"OK" + NEXT_CHUNK
        if data in pieces[:2]:
            return NEXT_CHUNK
        return b"done\x04\x04>" if data == b"cc" else b""

    board = FakeBoard(answer)
    assert RawPrompt(board).run("take()", pieces) == (NEXT_CHUNK * 3 + b"done").decode()  # type: ignore[arg-type]
    assert board.writes[-3:] == pieces


def test_silence_within_a_run_is_an_error_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prompt, "_RESPONSE_TIMEOUT_S", 0.01)
    with pytest.raises(FlashError, match="/dev/ttyFAKE: no answer within 0 s; flash again"):
        RawPrompt(FakeBoard(lambda data: b"OK" if data else b"")).run("x")  # type: ignore[arg-type]
