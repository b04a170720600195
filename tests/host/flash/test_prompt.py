"""The raw prompt of MicroPython on a port: order of bytes, errors of the board, and silence."""

from collections.abc import Callable

import pytest

from hubodo.flash import prompt
from hubodo.flash.prompt import NEXT_CHUNK, FlashError, RawPrompt

READY = b"raw REPL; CTRL-B to exit\r\n>"
PASTE = b"\x05A\x01"


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
    """Return a board without flow control, which declines it."""

    def answer(data: bytes) -> bytes:
        if data == PASTE:
            return b"R\x00"
        return b"OK" + printed + b"\x04" + raised + b"\x04>" if data.endswith(b"\x04") else b""

    return FakeBoard(answer)


class PastingBoard(FakeBoard):
    """A board with flow control; it reads `WINDOW` bytes at a time, and loses what it has no room for.

    refuse_after: number of bytes after which its compiler gives up.
    """

    WINDOW = 20

    def __init__(self, refuse_after: int | None = None) -> None:
        super().__init__(lambda data: b"")
        self.code, self._room, self._is_pasting, self._refuse_after = b"", 0, False, refuse_after
        self._is_refused = False

    def write(self, data: bytes) -> None:
        self._output += self._respond(data)

    def _respond(self, data: bytes) -> bytes:
        if not self._is_pasting:
            assert data == PASTE
            self._is_pasting, self._room, self.code = True, 2 * self.WINDOW, b""
            return b"R\x01" + self.WINDOW.to_bytes(2, "little") + b"\x01"
        if data == b"\x04":
            self._is_pasting = False
            error = b"SyntaxError: invalid syntax\r\n" if self._is_refused else b""
            return (b"" if self._is_refused else b"\x04") + b"\x04" + error + b"\x04>"
        self.code, self._room = self.code + data[: self._room], self._room - len(data)
        assert self._room >= 0, "bytes were lost"
        if self._refuse_after is not None and len(self.code) > self._refuse_after and not self._is_refused:
            self._is_refused = True
            return b"\x04"
        answer = b"\x01" * ((2 * self.WINDOW - self._room) // self.WINDOW)
        self._room += len(answer) * self.WINDOW
        return b"" if self._is_refused else answer


def test_code_is_sent_no_faster_than_the_board_makes_room() -> None:
    board, code = PastingBoard(), "x = 1  # \u00fc\n" * 50
    assert RawPrompt(board).run(code) == ""  # type: ignore[arg-type]
    assert board.code == code.encode()
    assert RawPrompt(board).run("y") == "" and board.code == b"y"  # type: ignore[arg-type]


def test_code_that_the_board_refuses_ends_with_its_reason() -> None:
    board = PastingBoard(refuse_after=100)
    with pytest.raises(FlashError, match=r"^/dev/ttyFAKE: SyntaxError: invalid syntax$"):
        RawPrompt(board).run("x = = 1\n" * 50)  # type: ignore[arg-type]
    assert len(board.code) < 200


def test_a_second_banner_before_the_answer_is_ignored() -> None:
    board = FakeBoard(
        lambda data: READY + b"R\x00" if data == PASTE else b"OK7\x04\x04>" * (data[-1:] == b"\x04")
    )
    assert RawPrompt(board).run("print(7)") == "7"  # type: ignore[arg-type]


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
    assert b"".join(board.writes) == PASTE + code.encode() + b"\x04"
    assert max(map(len, board.writes)) <= 256


def test_each_request_of_the_board_is_answered_with_the_next_piece() -> None:
    pieces = [b"aa", b"bb", b"cc"]

    def answer(data: bytes) -> bytes:
        if data == PASTE:
            return b"R\x00"
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
        RawPrompt(FakeBoard(lambda data: b"R\x00" if data == PASTE else b"")).run("x")  # type: ignore[arg-type]
