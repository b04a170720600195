"""The gap workflow on 240 s of two nodes at 100 Hz, one effect hidden: its parts, and one forward evaluation.

python tests/bench/bench_gap.py [ROUNDS]
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

import os
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from gap_matrix import cases, recording
from gap_matrix.dose import MEDIUM, Meter
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import initial_state
from hubodo.gap.problem.build import build
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED, SECONDS, HIDDEN = 5, 240.0, "wheel_camber"
FORWARD_LIMIT = 0.015  # s
EVALUATIONS = 50


def make(folder):
    """The log: 240 s, both nodes at 100 Hz."""
    setup = cases.sampled_at(cases.setup(SEED, duration=SECONDS), 100.0, np.random.default_rng(SEED))
    effect, _ = Meter(setup).dose(cases.hidden_effect(setup, HIDDEN, "left"), MEDIUM)
    recording.write(setup, [effect], folder, {})


def once(folder):
    """Seconds of each part in the order they come, and the names found."""
    marks = [("read the CSV folder", time.perf_counter())]
    log, model = read_folder(folder), read_model(folder / "model.toml")
    marks.append(("bring log and model together", time.perf_counter()))
    result = find_gap(log, model, say=lambda words, share: marks.append((words, time.perf_counter())))
    marks.append(("", time.perf_counter()))
    parts = {}
    for (words, begin), (_, end) in pairwise(marks):
        parts[words] = parts.get(words, 0.0) + end - begin
    return parts, [found.effect for found in result.found]


def forward(folder):
    """Seconds of the fastest of many evaluations, each with another radius, camber, arm and delay."""
    problem = build(read_folder(folder), read_model(folder / "model.toml"))
    taken = []
    for k in range(EVALUATIONS):
        effects = [
            BY_NAME["wheel_radius"](error=1e-4 * k),
            BY_NAME["wheel_camber"](angle=1e-3 * k),
            BY_NAME["lever_arm"](x=1e-4 * k, z=1e-3),
            BY_NAME["time_offset"](delay=1e-5 * k),
        ]
        state = initial_state(problem).with_terms([ModelTerm(effect, ALL) for effect in effects])
        begin = time.perf_counter()
        _ = state.readings
        taken.append(time.perf_counter() - begin)
    return min(taken), sum(len(node.t) for node in problem.nodes)


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    rounds = int(arguments[0]) if arguments else 3
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder)
        seconds, samples = forward(folder)
        parts, found = min((once(folder) for _ in range(rounds)), key=lambda made: sum(made[0].values()))
    print(
        f"gap workflow, {SECONDS:.0f} s, two nodes at 100 Hz, {HIDDEN} hidden (seed {SEED}), best of {rounds}"
    )
    for words, taken in parts.items():
        print(f"  {words:48} {taken:6.2f} s")
    print(f"  {'in all':48} {sum(parts.values()):6.2f} s   found: {', '.join(found) or 'nothing'}")
    print(
        f"  one forward evaluation, {samples} samples, best of {EVALUATIONS}: {1e3 * seconds:.1f} ms "
        f"(at most {1e3 * FORWARD_LIMIT:.0f})"
    )
    return not (seconds <= FORWARD_LIMIT and found == [HIDDEN])


if __name__ == "__main__":
    sys.exit(main())
