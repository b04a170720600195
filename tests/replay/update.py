"""Rewrite the references of the replay tests, after a change that intentionally changes the results."""

import json
import tempfile
from pathlib import Path

from recordings import REFERENCES, TABLE, arithmetic, play, reference


def main() -> None:
    stored: dict[str, object] = {"arithmetic": arithmetic()}
    for replay in TABLE:
        with tempfile.TemporaryDirectory() as folder:
            stored[replay.name] = reference(replay, play(replay, Path(folder)))
        print(replay.name, stored[replay.name])
    REFERENCES.write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
