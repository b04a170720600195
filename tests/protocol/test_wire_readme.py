"""protocol/README.md is sufficient and correct: layouts, fingerprint and examples are read from the page."""

import hashlib
import json
import re
from pathlib import Path

import pytest
import second_encoder

from hubowire import FINGERPRINT, MESSAGES
from hubowire.messages import ENUMS, upper_snake

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "protocol" / "README.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| [\d, ]+ \| `(\w+)` \| (.+?) \| (\S+) \| (.*?) \| .* \|$", re.M)
LETTERS = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "bytes": "s"}


def tables() -> dict[tuple[int, str], list[tuple[str, str, str, str]]]:
    """Return name, type, scale and unit of each field of the message sections of the page."""
    sections = re.split(r"^#### 0x([0-9A-F]{2}) (\w+)$", PAGE, flags=re.M)[1:]
    sections_by_id = {}
    for code, name, text in zip(sections[::3], sections[1::3], sections[2::3], strict=True):
        sections_by_id[int(code, 16), name] = ROW.findall(text.split("### ")[0].split("<!--")[0])
    return sections_by_id


def split_type(words: str) -> tuple[str, int, bool]:
    """Return base, count and is_counted_table of ``u8 count, then count x i16[6]``."""
    repeats = words.startswith("u8 count, then count x ")
    base, _, count = words.removeprefix("u8 count, then count x ").rstrip("]").partition("[")
    return base, int(count or 1), repeats


def test_the_second_encoder_has_the_layouts_of_the_page():
    assert {name for _, name in tables()} == set(second_encoder.PAYLOADS)
    for (_, name), rows in tables().items():
        layout = []
        for field, words, _, _ in rows:
            base, count, repeats = split_type(words)
            size = 0 if base == "bytes" else int(base[1:]) // 8
            if repeats:
                assert second_encoder.TABLES[name] == (field, size, base[0] == "i")
            else:
                layout.append((field, size, base[0] == "i", count))
        assert tuple(layout) == second_encoder.PAYLOADS[name]


def test_the_fingerprint_follows_from_the_page_alone():
    lines = []
    for (code, name), rows in tables().items():
        lines.append(f"message {code} {name}")
        for field, words, scale, unit in rows:
            base, count, repeats = split_type(words)
            type_code = f"{count if '[' in words else ''}{LETTERS[base]}{'[]' if repeats else ''}"
            lines.append(f"{field} {type_code} {scale} {unit}")
    for name, text in re.findall(r"^\*\*(\w+)\*\*: (.*)$", PAGE, re.M):
        if name in {enum.__name__ for enum in ENUMS}:
            codes = " ".join(f"{key}={value}" for value, key in re.findall(r"(\d+) `([A-Z]\w*)`", text))
            lines.append(f"enum {name} {codes}")
    digest = hashlib.sha256("\n".join(lines).encode()).digest()
    assert int.from_bytes(digest[:4], "little") == FINGERPRINT
    assert f"`{FINGERPRINT:08x}`" in PAGE


def test_the_worked_example_is_a_vector():
    example = PAGE.split("**Worked example.**")[1].split("```")[1]
    *_, (_, wire) = (line.split("  ", 1) for line in example.strip().splitlines())
    vectors = json.loads((ROOT / "protocol" / "vectors" / "nack.json").read_text())
    assert bytes.fromhex(wire).hex() in [vector["stream"] for vector in vectors]


def test_the_crc_of_the_page_has_the_check_value_it_names():
    snippet = PAGE.split("```python\n")[1].split("```")[0]
    names = {"data": b"123456789"}
    exec(snippet, names)
    assert names["crc"] == 0x29B1 and "**0x29B1**" in PAGE


@pytest.mark.parametrize("message", MESSAGES, ids=lambda kind: kind.__name__)
def test_every_request_has_its_answer_on_the_page(message: type):
    if message.type_id >= 0x40:
        assert f"| `{message.__name__}` | `" in PAGE


def test_the_vector_tool_makes_the_stored_vector_again_and_refuses_in_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import new_vector

    monkeypatch.setattr(new_vector, "VECTORS", tmp_path)
    values = ["request=70", "request_seq=7", "reason=3", "detail=412"]
    settings = [part for value in values for part in ("--set", value)]
    assert new_vector.main(["message", "Nack", "typical", "--node", "2", "--seq", "258", *settings]) == 0
    vector_file = json.loads((tmp_path / "nack.json").read_text())
    stored = json.loads((ROOT / "protocol" / "vectors" / "nack.json").read_text())
    assert vector_file == [vector for vector in stored if vector["name"] == "typical"]
    assert new_vector.main(["stream", "bad_x", "noise", "050500", "--origin", "by hand"]) == 0
    assert json.loads((tmp_path / "bad_x.json").read_text())[0]["damage"]["cobs"] == 1
    capsys.readouterr()
    for wrong in (["Nac", "x"], ["Nack", "x", "--set", "reason=999"], ["Nack", "x", "--set", "nothing=1"]):
        assert new_vector.main(["message", *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert upper_snake("TimeReply").lower() == "time_reply"
