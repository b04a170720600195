"""Code that a board runs during flashing, run here in a folder that stands for its file system.

Real MicroPython runs the same code in tests/signal_path; here each snippet is tested alone, including power
cuts.
"""

import ast
import builtins
import hashlib
import io
import os
import types
from collections.abc import Callable
from pathlib import Path

import pytest

from hubodo.flash import snippets


class Board:
    """A file system in a folder; `run` executes code as a board does and returns what it prints."""

    def __init__(self, root: Path) -> None:
        self.root, self.sent = root, io.StringIO()
        self._cut_after: int | None = None
        board_os = types.ModuleType("os")
        for name in ("mkdir", "remove", "rmdir", "rename"):
            setattr(board_os, name, self._rooted(getattr(os, name)))
        board_os.ilistdir = self._ilistdir  # type: ignore[attr-defined]
        board_sys = types.ModuleType("sys")
        board_sys.stdin = self.sent  # type: ignore[attr-defined]
        self.requests = io.StringIO()
        board_sys.stdout = self.requests  # type: ignore[attr-defined]
        modules = {"os": board_os, "sys": board_sys}
        self._printed = io.StringIO()
        self._names = {
            "__builtins__": {
                **vars(builtins),
                "__import__": lambda name, *options: modules.get(name) or __import__(name, *options),
                "open": lambda name, mode="r": self.path(name).open(mode),
                "print": lambda *values: print(*values, file=self._printed),
            }
        }

    def path(self, name: str) -> Path:
        return self.root / name.lstrip("/")

    def cut_after(self, operations: int) -> None:
        """Let the board lose power after this number of changes of the file system."""
        self._cut_after = operations

    def _rooted(self, operation: Callable[..., None]) -> Callable[..., None]:
        def call(*names: str) -> None:
            if self._cut_after is not None:
                if self._cut_after == 0:
                    raise KeyboardInterrupt("power cut")
                self._cut_after -= 1
            operation(*map(self.path, names))

        return call

    def _ilistdir(self, folder: str) -> list[tuple[str, int]]:
        return [(it.name, 0x4000 if it.is_dir() else 0x8000) for it in sorted(self.path(folder).iterdir())]

    def run(self, code: str) -> str:
        self._printed.seek(0)
        self._printed.truncate()
        exec(compile(code, "board", "exec"), self._names)
        return self._printed.getvalue()

    def write(self, **files: bytes) -> None:
        for name, content in files.items():
            path = self.path(name.replace("__", "/").replace("_py", ".py"))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    def files(self) -> dict[str, bytes]:
        return {
            str(it.relative_to(self.root)): it.read_bytes() for it in self.root.rglob("*") if it.is_file()
        }


@pytest.fixture
def board(tmp_path: Path) -> Board:
    return Board(tmp_path)


def test_hashes_are_those_of_the_files_in_the_listed_folders_with_the_start_program(board: Board) -> None:
    board.write(main_py=b"import a\n", a__x_py=bytes(1500), a__drivers__y_py=b"", other__z_py=b"z")
    lines = board.run(snippets.LIST_HASHES.format(folders=["/a", "/a/drivers"])).splitlines()
    hashes = dict(reversed(line[2:].split(" ")) for line in lines if line.startswith("# "))
    assert hashes == {
        "/main.py": hashlib.sha256(b"import a\n").hexdigest(),
        "/a/x.py": hashlib.sha256(bytes(1500)).hexdigest(),
        "/a/drivers/y.py": hashlib.sha256(b"").hexdigest(),
    }
    assert "import a" in lines


def test_a_board_without_start_program_is_listed_too(board: Board) -> None:
    assert board.run(snippets.LIST_HASHES.format(folders=[])).strip() == ""


def test_preparing_makes_folders_removes_and_copies_and_may_be_repeated(board: Board) -> None:
    board.write(a__x_py=bytes(range(256)) * 5, b__old_py=b"old")
    code = snippets.PREPARE.format(
        folders=["/b", "/b/drivers"], remove=["/b/old.py"], copy=[("/a/x.py", "/b/x.py")]
    )
    board.run(code)
    assert board.path("/b/drivers").is_dir()
    assert board.files() == {"a/x.py": bytes(range(256)) * 5, "b/x.py": bytes(range(256)) * 5}
    board.run(snippets.PREPARE.format(folders=["/b"], remove=[], copy=[("/a/x.py", "/b/x.py")]))
    assert len(board.files()) == 2


@pytest.mark.parametrize("size", [0, 1, 256, 257, 1000])
def test_a_file_is_received_in_pieces_of_hexadecimal_digits_each_on_request(board: Board, size: int) -> None:
    content = bytes(k * 7 % 256 for k in range(size))
    board.sent.write(content.hex())
    board.sent.seek(0)
    board.run(snippets.RECEIVE_FILE.format(piece=256, wanted=repr("\x06")))
    board.run(f"take('/x.py',{size})")
    assert board.path("/x.py").read_bytes() == content
    assert board.requests.getvalue() == "\x06" * -(-size // 256)


def test_a_power_cut_leaves_a_complete_start_program(
    board: Board,
) -> None:
    """main.py is replaced by one rename, before old files are removed."""
    code = snippets.SWAP.format(swap=["main.py"], new=".new", forget=["/a/x.py"], folders=["/a", "/empty"])
    for cut in range(4):
        board.write(**{"main_py": b"old", "main_py.new": b"new", "a__x_py": b"x"})
        board.path("/empty").mkdir(exist_ok=True)
        board.cut_after(cut)
        try:
            board.run(code)
        except KeyboardInterrupt:
            assert board.path("/main.py").read_bytes() == (b"old" if cut == 0 else b"new")
            assert board.path("/a/x.py").exists() == (cut < 2)
    # Neither a folder with files nor a missing one is an error.
    board.cut_after(99)
    board.write(**{"main_py.new": b"newer", "a__x_py": b"x", "a__y_py": b"y"})
    board.run(snippets.SWAP.format(swap=["main.py"], new=".new", forget=["/a/x.py"], folders=["/a", "/gone"]))
    assert board.files() == {"main.py": b"newer", "a/y.py": b"y"}


def test_a_rollback_changes_the_slot_alone(board: Board) -> None:
    board.write(main_py=b"SLOT = '/a'\nimport boot\n")
    board.run(snippets.ROLL_BACK.format(new=".new", now="SLOT = '/a'", then="SLOT = '/b'"))
    assert board.files() == {"main.py": b"SLOT = '/b'\nimport boot\n"}


def test_identity_and_reset_are_single_lines_of_valid_python() -> None:
    for code in (snippets.IDENTIFY, snippets.SERIAL, snippets.RESET):
        assert "\n" not in code
        ast.parse(code)
