"""The files that a virtual board in WebAssembly gets."""

import json
import subprocess
from pathlib import Path

from hubodo.emulator.interpreters import find
from virtual_runs import micropython_or_skip

FLASH = Path(find.__file__).parent / "wasm" / "flash.mjs"
MOUNT = f"""
import {{ layRom }} from {json.dumps(FLASH.as_uri())};
const files = [];
layRom({{ mkdir: () => 0, writeFile: (name) => files.push(name) }}, process.argv[1]);
console.log(JSON.stringify(files.sort()));
"""


def test_the_bytecode_folder_of_an_installed_package_is_not_mounted(tmp_path: Path) -> None:
    micropython_or_skip()
    (tmp_path / "__pycache__").mkdir()
    for name in ("_boot.py", "_time.py", "__pycache__/_boot.cpython-311.pyc"):
        (tmp_path / name).touch()
    command = [find.find_node(), "--input-type=module", "--eval", MOUNT, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["/rom/_boot.py", "/rom/_time.py"]
