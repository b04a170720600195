"""The demo as a process of its own: a short drive, and what it printed."""

import subprocess
import sys

MOVING, SEED = 6.0, 7


def run(folder):
    """(exit code, standard output, standard error) of `hubodo demo`; it drives in real time."""
    words = ["demo", "--moving", str(MOVING), "--seed", str(SEED), "-o", str(folder), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "hubodo", *words], capture_output=True, text=True, timeout=160
    )
    return done.returncode, done.stdout, done.stderr
