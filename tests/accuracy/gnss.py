"""Loops of 250 m with GNSS of 5 m at 5 Hz: the graph beside the fixes alone and the wheels alone.

    python tests/accuracy/gnss.py [DRIVES [FIRST_SEED]]

Drives, sensors and fixes are made by tests/generators, which share no code with the filter and the graph.
Wheels alone know neither where they are nor which way they face, so they are judged three ways: laid on the
fixes of their first 30 m and of their first 50 m, as who has both would do without a graph, and told their
true first pose and heading. What is told the truth has less to find than the graph, and any other estimate is
nearer the truth by luck at times, so the drives in which it is are counted and the largest lead is told. For
equal knowledge the graph told the first heading, judged from its own start, stands beside wheels told theirs.
An outage of 60 s is judged twice: in the track of the whole log, and in that of a log which ends with the
outage.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import gnss_drives, wheel_drives
from hubodo.fuse.graph.batch import Fixes, GraphConfig, fuse_graph
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.fuse.wheel_odometry import graph_constant_sigmas
from hubodo.recording import Table

SIGMA, RATE_HZ, OUTAGE = 5.0, 5.0, 60.0
ORIGIN = (47.37, 8.54)
LAID = {f"wheels laid on their first {length:g} m, rms m": length for length in (30.0, 50.0)}


def odometry(drive, names):
    """Return the wheel filter's track, and the prior sigmas of its constants."""
    config = WheelConfig(drive.radius, drive.track, {name: WheelNode(name, "left") for name in names})
    columns = ("t", "gx", "gy", "gz", "ax", "ay", "az")
    nodes = {
        name: Table(dict(zip(columns, np.column_stack([node.t, node.gyro, node.accel]).T, strict=True)))
        for name, node in drive.nodes.items()
    }
    result = run_wheel_filter(config, nodes)
    track = result.track
    return Track(track.t, track.x, track.y, track.heading), graph_constant_sigmas(result)


def off(track, frame, drive):
    """Return the error of a track at its times, m, and its normalised square."""
    zero = np.zeros(1)
    x, y = frame.to_local(*gnss_drives.geodetic(zero, zero, *ORIGIN))
    ex = track.x - x[0] - np.interp(track.t, drive.t, drive.x)
    ey = track.y - y[0] - np.interp(track.t, drive.t, drive.y)
    return np.hypot(ex, ey), (ex / track.sigma_x) ** 2, (ey / track.sigma_y) ** 2


def laid(path, t, place, length):
    """Return the wheels' positions, east + i north, aligned with the fixes of the first metres."""
    selected = path.x + 1j * path.y
    rolled = np.append(0.0, np.cumsum(np.abs(np.diff(selected))))
    first = np.interp(t, path.t, rolled) < length
    there, fixes = np.interp(t, path.t, path.x) + 1j * np.interp(t, path.t, path.y), place[0] + 1j * place[1]
    middle, target = there[first].mean(), fixes[first].mean()
    turn = np.angle(np.sum(np.conj(there[first] - middle) * (fixes[first] - target)))
    return target + np.exp(1j * turn) * (selected - middle)


def one(seed, names):
    rng = np.random.default_rng([seed, 53])
    drive = wheel_drives.drive(wheel_drives.loop(rng), rng)
    path, constants = odometry(drive, names)
    config = GraphConfig(constants=constants)
    t = np.arange(path.t[0] + rng.uniform(0.0, 1.0 / RATE_HZ), path.t[-1], 1.0 / RATE_HZ)
    noise = SIGMA * rng.standard_normal((2, len(t)))
    place = np.array([np.interp(t, drive.t, v) for v in (drive.x, drive.y)]) + noise
    latitude, longitude = gnss_drives.geodetic(*place, *ORIGIN)
    began = time.process_time()
    full = fuse_graph(path, Fixes(t, latitude, longitude), None, config)
    used = time.process_time() - began
    error, in_x, in_y = off(full.track, full.frame, drive)
    truth = (np.interp(path.t, drive.t, v) for v in (drive.x, drive.y, drive.heading))
    tx, ty, th = truth
    turn = np.exp(1j * (th[0] - path.heading[0]))
    single = (path.x - path.x[0] + 1j * (path.y - path.y[0])) * turn + tx[0] + 1j * ty[0] - tx - 1j * ty
    wheels = np.sqrt(np.mean(np.abs(single) ** 2))
    aligned = {
        name: np.sqrt(np.mean(np.abs(laid(path, t, place, length) - tx - 1j * ty) ** 2))
        for name, length in LAID.items()
    }
    facing = replace(config, start_heading=float(th[0]), start_heading_sigma=2e-3)
    reported = fuse_graph(path, Fixes(t, latitude, longitude), None, facing).from_start
    like = np.sqrt(np.mean((reported.x - tx + tx[0]) ** 2 + (reported.y - ty + ty[0]) ** 2))

    start = rng.uniform(0.35, 0.55) * path.t[-1]
    keep = (t < start) | (t > start + OUTAGE)
    after = fuse_graph(path, Fixes(t[keep], latitude[keep], longitude[keep]), None, config)
    cut = path.t <= start + OUTAGE
    ended = Track(path.t[cut], path.x[cut], path.y[cut], path.heading[cut])
    fixes = Fixes(t[t < start], latitude[t < start], longitude[t < start])
    before = fuse_graph(ended, fixes, None, config)
    end = int(np.count_nonzero(cut)) - 1
    inside = (path.t >= start) & cut
    distance = float(np.sum(np.hypot(np.diff(tx[inside]), np.diff(ty[inside]))))
    smoothed = off(after.track, after.frame, drive)[0]
    ahead, ax, ay = off(before.track, before.frame, drive)
    begun = int(np.flatnonzero(inside)[0])
    return {
        "graph, rms m": np.sqrt(np.mean(error**2)),
        "fixes alone, rms m": np.sqrt(np.mean(np.sum(noise**2, axis=0))),
        **aligned,
        "wheels told their first pose, rms m": wheels,
        "graph told the first heading, from start": like,
        "outage, whole log: error at its end, %": 100.0 * smoothed[end] / distance,
        "outage, whole log: worst in it, %": 100.0 * smoothed[inside].max() / distance,
        "outage, log ends with it: error, %": 100.0 * ahead[end] / distance,
        "  of which grown in it, %": 100.0 * max(0.0, ahead[end] - ahead[begun]) / distance,
        "squares / sigma squared, x": np.mean(in_x),
        "squares / sigma squared, y": np.mean(in_y),
        "at the end": in_x[-1],
        "outage end": 0.5 * (ax[end] + ay[end]),
        "CPU s": used,
    }


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    drives = int(arguments[0]) if arguments else 40
    first = int(arguments[1]) if len(arguments) > 1 else 0
    began = time.monotonic()
    missed = []
    for names in (("left", "right"), ("left",)):
        rows = [one(seed, names) for seed in range(first, first + drives)]
        print(f"nodes {' and '.join(names)}: {drives} loops of 250 m, seeds {first}..{first + drives - 1}, "
              f"fixes of {SIGMA:g} m at {RATE_HZ:g} Hz")  # fmt: skip
        print(f"  {'':42}{'median':>9}{'90 %':>9}{'largest':>9}")
        for name in rows[0]:
            values = np.array([row[name] for row in rows])
            numbers = (np.median(values), np.quantile(values, 0.9), values.max())
            print(f"  {name:42}" + "".join(f"{value:9.2f}" for value in numbers))
        graph, fixes, wheels, reported, *aligned = (
            np.array([row[name] for row in rows])
            for name in (
                "graph, rms m",
                "fixes alone, rms m",
                "wheels told their first pose, rms m",
                "graph told the first heading, from start",
                *LAID,
            )
        )
        others = {"the fixes alone": fixes, "the wheels told their first pose": wheels}
        others |= {name.removesuffix(", rms m"): values for name, values in zip(LAID, aligned, strict=True)}
        print(f"  drives of {drives} in which the graph has the larger rms, and by how much at most, m")
        for name, values in others.items():
            print(f"    than {name:40}{np.sum(graph > values):5}{max(0.0, (graph - values).max()):9.2f}")
        print(f"    told the heading, than those told, too  {np.sum(reported > wheels):10}"
              f"{max(0.0, (reported - wheels).max()):9.2f}")  # fmt: skip
        print("  rms over all drives, m: graph {:.2f}, fixes {:.2f}, wheels told {:.2f}, graph told {:.2f}, "
              "wheels laid {:.2f}, {:.2f}".format(*(np.sqrt(np.mean(values**2)) for values in
              (graph, fixes, wheels, reported, *aligned))))  # fmt: skip
        within = np.array([row["at the end"] for row in rows]) < 1.96**2
        print(f"  final x within 1.96 sigma: {100.0 * np.mean(within):.0f} % of the drives")
        outage = np.median([row["outage, whole log: error at its end, %"] for row in rows])
        claims = {
            "rms at most 1.0 m on every drive": graph.max() <= 1.0,
            "never worse than the fixes alone": bool(np.all(graph < fixes)),
            "at most 0.2 m worse than the wheels laid on fixes": bool(
                np.all(graph < np.min(aligned, 0) + 0.2)
            ),
            "better than the wheels told the truth over all drives": np.mean(graph**2) < np.mean(wheels**2),
            "outage at most 1 % in the median": outage <= 1.0,
        }
        missed += [f"{text} ({' and '.join(names)})" for text, met in claims.items() if not met]
    print(f"{time.monotonic() - began:.0f} s; claims: {missed or 'all met'}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
