"""Overlapping Allan deviation of 10 million samples, octaves, beside allantools: processor time, memory.

python tests/bench/bench_allan.py [SAMPLES]
"""

import statistics
import subprocess
import sys
import time

import numpy as np
from speedups import record_speedup

ROUNDS = 5
RATIO = 0.25

_MEMORY = """
import sys, tracemalloc
import numpy as np
samples = np.random.default_rng(0).normal(0.02, 0.004, int(sys.argv[2]))
if sys.argv[1] == "ours":
    from hubodo.sensors.allan.deviation import allan_deviation as run
else:
    import allantools
    run = lambda s, dt: allantools.oadev(s, rate=1 / dt, data_type="freq", taus="octave")
tracemalloc.start()
run(samples, 0.01)
print(tracemalloc.get_traced_memory()[1] / 2**20)
"""


def peak_mib(who, count):
    """Return the memory in MiB beyond the samples themselves, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", _MEMORY, who, str(count)], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def main(argv=None):
    import allantools

    from hubodo.sensors.allan.deviation import allan_deviation

    arguments = sys.argv[1:] if argv is None else argv
    count = int(arguments[0]) if arguments else 10_000_000
    samples = np.random.default_rng(0).normal(0.02, 0.004, count)
    times = {"ours": [], "allantools": []}
    for _ in range(ROUNDS):
        began = time.process_time()
        ours = allan_deviation(samples, 0.01)
        middle = time.process_time()
        tau, theirs, _, _ = allantools.oadev(samples, rate=100.0, data_type="freq", taus="octave")
        times["ours"].append(middle - began)
        times["allantools"].append(time.process_time() - middle)
    same = np.isin(ours.factors, np.rint(tau * 100).astype(int))
    worst = float(np.max(np.abs(ours.adev[same] / theirs - 1)))
    medians = {who: statistics.median(durations) for who, durations in times.items()}
    each = [b / a for a, b in zip(times["ours"], times["allantools"], strict=True)]
    record_speedup(f"Allan deviation of {count} samples: allantools", each)
    memory = {who: peak_mib(who, count) for who in times}
    ratio = medians["ours"] / medians["allantools"]
    print(
        f"overlapping Allan deviation, {count} samples, {len(ours.tau)} octaves, processor time, "
        f"median of {ROUNDS} rounds (seed 0)"
    )
    for who in times:
        print(f"  {who:11} {medians[who]:.3f} s   {memory[who]:.0f} MiB beyond the samples")
    print(
        f"  time ratio {ratio:.2f} (at most {RATIO}); memory ratio "
        f"{memory['ours'] / memory['allantools']:.2f} (below 1)"
    )
    print(f"  largest relative difference {worst:.1e} (below 1e-10)")
    return not (ratio <= RATIO and memory["ours"] < memory["allantools"] and worst < 1e-10)


if __name__ == "__main__":
    sys.exit(main())
