"""Generated files agree with the message table, and the check detects a stale one."""

import subprocess
import sys
from pathlib import Path

import pytest

from hubowire import FINGERPRINT, MAX_FRAME, MAX_PAYLOAD, MESSAGES, OVERHEAD, budget
from hubowire.codec import payload_layout
from hubowire.messages import ENUMS, upper_snake

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def node_names() -> dict:
    names: dict = {}
    for file in ("wire.py", "wire_more.py", "radio/wire_update.py"):
        text = (ROOT / "firmware" / file).read_text()
        exec(text.replace("from micropython import const", "const = int"), names)
    return names


def test_generated_files_are_up_to_date():
    run = subprocess.run(
        [sys.executable, ROOT / "tools" / "gen_wire.py", "--check"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr


def test_the_check_names_a_stale_file_in_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import gen_wire

    stale = tmp_path / "wire.py"
    stale.write_text(gen_wire.wire_module().replace("HELLO = const(0x01)", "HELLO = const(0x09)"))
    monkeypatch.setattr(gen_wire, "WIRE", stale)
    for name in ("WIRE_MORE", "WIRE_UPDATE"):
        path = getattr(gen_wire, name)
        monkeypatch.setattr(gen_wire, name, tmp_path / path.name)
        (tmp_path / path.name).write_text(path.read_text())
    monkeypatch.setattr(gen_wire, "ROOT", tmp_path)
    monkeypatch.setattr(gen_wire, "README", tmp_path / "README.md")
    empty = "".join(
        f"<!-- generated: {name} -->\n<!-- end: {name} -->\n" for name in gen_wire.readme_blocks()
    )
    (tmp_path / "README.md").write_text(gen_wire.fill(empty, gen_wire.readme_blocks()))
    assert gen_wire.main(["--check"]) == 1
    assert capsys.readouterr().err == "out of date: wire.py; run tools/gen_wire.py\n"
    assert "0x09" in stale.read_text()
    assert gen_wire.main([]) == 0
    assert gen_wire.main(["--check"]) == 0


def test_the_node_knows_every_message_by_id_format_and_size(node_names: dict):
    for message in MESSAGES:
        name, shape = upper_snake(message.__name__), payload_layout(message)
        assert node_names[name] == message.type_id
        if shape.fixed.size:
            assert node_names[f"{name}_FORMAT"] == shape.fixed.format
            assert node_names[f"{name}_SIZE"] == shape.fixed.size
    assert node_names["IMU_BATCH_ROW"] == "<6h"
    most = node_names["IMU_BATCH_MAX_ROWS"]
    assert budget.imu_frame_bytes(most) <= MAX_FRAME < budget.imu_frame_bytes(most + 1)


def test_the_node_knows_every_code_and_the_frame_sizes(node_names: dict):
    for enum in ENUMS:
        for item in enum:
            assert node_names[f"{upper_snake(enum.__name__)}_{item.name}"] == item.value
    assert node_names["FINGERPRINT"] == FINGERPRINT
    sizes = [node_names[name] for name in ("MAX_FRAME", "MAX_PAYLOAD", "OVERHEAD")]
    assert sizes == [MAX_FRAME, MAX_PAYLOAD, OVERHEAD]


def test_the_budget_agrees_with_sums_done_by_hand():
    # 8 + 14 + 16 x 12 = 214 bytes, 13 times per second at 208 Hz; also 5 Filter frames of 67 bytes, 10 Mag of
    # 18, one Health of 41 and one TimeReply of 24 per second, and a Hello of 8 + 51 + 2 x 3 every five
    # seconds.
    assert budget.imu_frame_bytes(16) == 214
    assert budget.node_bytes_per_s(208, 16) == pytest.approx(13 * 214 + 335 + 180 + 41 + 24 + 65 / 5)
    assert budget.link_load(budget.serial_link(115200), 208, 16) == pytest.approx(3375 / 11520)
    # One full packet at 250 kb/s: 8 + 32 bytes and 9 bits, the acknowledgement 8 bytes and 9 bits, 2 x 130
    # us.
    packet_s = (40 * 8 + 9) / 250e3 + (8 * 8 + 9) / 250e3 + 260e-6
    assert budget.nrf24_link().load(30, 1) == pytest.approx(packet_s)
