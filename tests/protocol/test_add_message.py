"""The recipe "add a message" of CONTRIBUTING.md, carried out in a copy of the repository."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.release

ROOT = Path(__file__).resolve().parents[2]
MESSAGE = '''
@dataclass(frozen=True, slots=True)
class Humidity(Message):
    """Relative humidity inside the case."""

    type_id: ClassVar[int] = 0x3E
    t_us: int = declare_field("I", _DEVICE_TIME, unit="us")
    humidity: int = declare_field("H", "relative humidity", scale="1e-2", unit="%")


NodeMessage ='''
ROUND_TRIP = """
import hubowire
from hubowire.messages import Humidity
message = Humidity(5, 4321)
assert hubowire.decode(0x3E, hubowire.encode(message)) == message
print(f"{hubowire.FINGERPRINT:08x}")
"""
CHECKED = ("codec", "fingerprint", "generated", "readme")


def replace_once(path: Path, old: str, new: str) -> None:
    text = path.read_text("utf-8")
    assert text.count(old) == 1, (path.name, old)
    path.write_text(text.replace(old, new), "utf-8")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for folder in ("protocol", "tools", "firmware", "tests/protocol"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored)
    return tmp_path


def run(copy: Path, *command: str) -> str:
    paths = (copy / "protocol", ROOT / "host")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    done = subprocess.run(
        [sys.executable, *command], cwd=copy, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_new_message_is_one_class_one_line_and_generated_files_and_no_other_test_fails(copy: Path):
    before = run(copy, "-c", "import hubowire; print(f'{hubowire.FINGERPRINT:08x}')").strip()
    table = copy / "protocol" / "hubowire" / "messages.py"
    replace_once(table, "\nNodeMessage =", MESSAGE)
    replace_once(table, " | HighG | UpdateState\n", " | HighG | UpdateState | Humidity\n")
    run(copy, "tools/gen_wire.py")
    assert "HUMIDITY = const(0x3E)" in (copy / "firmware" / "wire.py").read_text("utf-8")
    page = (copy / "protocol" / "README.md").read_text("utf-8")
    assert "#### 0x3E Humidity" in page
    after = run(copy, "-c", ROUND_TRIP).strip()
    assert after != before
    assert f"`{after}`" in page
    replace_once(
        copy / "tests" / "protocol" / "second_encoder.py",
        '    "Ping": (),\n',
        '    "Ping": (),\n    "Humidity": (("t_us", 4, False, 1), ("humidity", 2, False, 1)),\n',
    )
    for name, values in (
        ("typical", ("t_us=5", "humidity=4321")),
        ("largest", ("t_us=1073741823", "humidity=65535")),
    ):
        settings = [part for value in values for part in ("--set", value)]
        run(copy, "tools/new_vector.py", "message", "Humidity", name, *settings)
    tests = [f"tests/protocol/test_wire_{name}.py" for name in CHECKED]
    tests.append("tests/protocol/test_wire_vectors.py::test_every_message_has_a_typical_vector_and_extremes")
    output = run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--rootdir={copy}", *tests)
    assert "passed" in output and "failed" not in output
