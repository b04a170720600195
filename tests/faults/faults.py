"""`make faults`: the table of faults with the present outcome of its tests, and figures; not a test."""

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

# The folder of the tests must come first in the path.
from faults.fault import Fault  # noqa: E402
from faults.figures import print_figures  # noqa: E402
from faults.table import FAULTS  # noqa: E402

_WIDTHS = (36, 42, 34)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument(
        "--files", type=int, default=1000, help="changed files for the readers (default 1000)"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="of the flood of handshakes (default 60)")
    parser.add_argument("--seed", type=int, help="of files and sentences (default: the date)")
    args = parser.parse_args()
    wanted = sorted({test for fault in FAULTS for test in fault.tests})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        words = [sys.executable, "-m", "pytest", "-q", f"--kills={args.kills}", f"--junit-xml={report}"]
        words += ["-o", "junit_family=xunit1"]  # with the properties that tests record
        code = subprocess.run([*words, "--timeout=1800", *(str(TESTS / test) for test in wanted)]).returncode
        outcomes_by_fault, figures = outcomes(report), properties(report)
    print(*(line for fault in FAULTS for line in rows(fault, outcomes_by_fault)), sep="\n")
    survived = sum(set(endings(fault, outcomes_by_fault)) == {"passed"} for fault in FAULTS)
    print(f"\n{survived} of {len(FAULTS)} kinds of fault survived", *figures, sep="\n", flush=True)
    complete = print_figures(args.files, args.seconds, args.seed)
    return code or int(not complete)


def outcomes(report: Path) -> dict[str, list[str]]:
    """Return the outcomes of each test by function: one word per set of parameters."""
    outcomes_by_fault: dict[str, list[str]] = defaultdict(list)
    for case in xml.parse(report).iter("testcase"):
        ended = [child.tag for child in case if child.tag in ("failure", "error", "skipped")]
        outcomes_by_fault[case.attrib["name"].partition("[")[0]].append(ended[0] if ended else "passed")
    return outcomes_by_fault


def properties(report: Path) -> list[str]:
    """Return the figures that tests have recorded."""
    outcomes_by_fault = xml.parse(report).iter("property")
    return [item.attrib["value"] for item in outcomes_by_fault if item.attrib["name"] == "figure"]


def endings(fault: Fault, outcomes_by_fault: dict[str, list[str]]) -> list[str]:
    """Return the outcome of each test of a fault."""
    return [
        word for test in fault.tests for word in outcomes_by_fault.get(test.partition("::")[2], ["not run"])
    ]


def rows(fault: Fault, outcomes_by_fault: dict[str, list[str]]) -> list[str]:
    """Return the row of a fault, wrapped to the widths of the columns."""
    ended = endings(fault, outcomes_by_fault)
    counts = ", ".join(f"{ended.count(word)} {word}" for word in dict.fromkeys(sorted(ended)))
    texts = (fault.what, fault.expected, fault.reported_by)
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
