"""`make faults`: the table of faults with what its tests say now, kills in full number; not a test."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import textwrap
import xml.etree.ElementTree as xml
from collections import defaultdict
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS))

# The folder of the tests is to be found first.
from faults.guessing import WAYS, measure  # noqa: E402
from faults.table import FAULTS, Fault  # noqa: E402

_WIDTHS = (36, 42, 34)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    args = parser.parse_args()
    wanted = sorted({test for fault in FAULTS for test in fault.tests})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        words = [sys.executable, "-m", "pytest", "-q", f"--kills={args.kills}", f"--junit-xml={report}"]
        code = subprocess.run([*words, "--timeout=1800", *(str(TESTS / test) for test in wanted)]).returncode
        found = outcomes(report)
    print(*(line for fault in FAULTS for line in rows(fault, found)), sep="\n")
    print(*map(measure, WAYS), sep="\n")
    return code


def outcomes(report: Path) -> dict[str, list[str]]:
    """What became of each test, by its function: one word for each set of its parameters."""
    found: dict[str, list[str]] = defaultdict(list)
    for case in xml.parse(report).iter("testcase"):
        ended = [child.tag for child in case if child.tag in ("failure", "error", "skipped")]
        found[case.attrib["name"].partition("[")[0]].append(ended[0] if ended else "passed")
    return found


def rows(fault: Fault, found: dict[str, list[str]]) -> list[str]:
    """The row of a fault, broken to the widths of the columns."""
    ended = [word for test in fault.tests for word in found.get(test.partition("::")[2], ["not run"])]
    counts = ", ".join(f"{ended.count(word)} {word}" for word in dict.fromkeys(sorted(ended)))
    texts = (fault.what, fault.expected, fault.told_by)
    columns = [textwrap.wrap(text, width) for text, width in zip(texts, _WIDTHS, strict=True)] + [[counts]]
    high = max(map(len, columns))
    cells = [column + [""] * (high - len(column)) for column in columns]
    lines = zip(*cells, strict=True)
    return [
        "  ".join(f"{text:{width}}" for text, width in zip(line, (*_WIDTHS, 0), strict=True))
        for line in lines
    ]


if __name__ == "__main__":
    sys.exit(main())
