"""Odd records for allan, warmup, north and heading: valid, refused or warned, or silently wrong; coverage.

    python tests/accuracy/odd_records.py [--seeds 20] [--first 0] [--only VERB] [--rows TEXT]

Each row disturbs a record of an independent simulator; see `generators/odd_records.py`. Wrong: beyond 4
sigma. Warned: a note that the same verb does not give for the record without disturbance. Coverage: share of
all answers within 1.96 sigma, with its binomial 95 % interval (Clopper and Pearson).
"""

import os
import re
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import warm_ups
from generators.noise import gyro_noise
from generators.odd_records import ADDED, CHANGES, FAST_CLOCK, disturb, ramp_and_return
from generators.steady_turns import steady_turns
from generators.table_record import DEG_H, table_record
from generators.table_worlds import NOISE, even
from hubodo.errors import HubodoError
from hubodo.recording import Recording, Table
from hubodo.sensors.allan.characterise import characterise_standstill_noise
from hubodo.sensors.heading.estimate import HeadingOptions, heading_from_recording
from hubodo.sensors.north.from_recordings import NorthOptions, north_from_recordings
from hubodo.sensors.standstill_channel import read_standstill_channel
from hubodo.sensors.warmup.characterise import characterise_standstill_warmup
from script_arguments import script_parser

DEG = np.pi / 180
BIASES = ("bias step", "ramp up and down", "bias walks", "daily cycle")
"""Disturbances that are part of the bias; the others are noise about it."""
SHARED_ROWS = {name: (name, {}) for name in ("none", *ADDED, *CHANGES)}
TWO = {"programme": even(turns=[180, -180] * 6), "method": "maytag"}
NORTH_ROWS = {
    "reversed, 0.1 deg lean": ("axes reversed", {"lean": (0.0012, 0.0013)}),
    "0.1 deg lean": ("none", {"lean": (0.0012, 0.0013)}),
    "latitude -35": ("none", {"latitude": -35.0}),
    "latitude 0": ("none", {"latitude": 0.0}),
    "latitude 70": ("none", {"latitude": 70.0}),
    "latitude 45 as 60": ("none", {"given": 60.0}),
    "latitude 45 as 30": ("none", {"given": 30.0}),
    "latitude 45 as 0.785": ("none", {"given": 0.785}),
    "latitude -45 as 45": ("none", {"latitude": -45.0, "given": 45.0, "lean": (0.02, 0.02)}),
    "two directions": ("none", TWO),
    "two, 45 as 60": ("none", {**TWO, "given": 60.0}),
    "two, 45 as 30": ("none", {**TWO, "given": 30.0}),
}
HEADING_ROWS = {
    "three standstills": ("none", {"standstills": (2, 5, 8)}),
    "three, bias step": ("bias step", {"standstills": (2, 5, 8)}),
    "three, bias walks": ("bias walks", {"standstills": (2, 5, 8)}),
    "three, LSB of 15 sigma": ("LSB of 15 sigma", {"standstills": (2, 5, 8)}),
    "warm-up of 0.1 deg/s": ("none", {"warmup": 0.1}),
    "3 °C and back": ("none", {"thermometer": True}),
}
EXTRA_ROWS = {"north": NORTH_ROWS, "heading": HEADING_ROWS}


@dataclass
class Answer:
    """Errors in units of sigma, and the notes of a result."""

    pulls: list = field(default_factory=list)
    notes: tuple = ()


def recording(t, gyro, accel, temperature=None):
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    return Recording({"imu": Table(columns | ({} if temperature is None else {"temperature": temperature}))})


def gravity(rng, count, noise=0.02):
    return np.array([0.05, -0.08, 9.81]) + noise * rng.standard_normal((count, 3))


ALLAN = {"n": 1e-4, "b": 3e-5, "k": 3e-6}


def allan(name, seed, **_):
    """Judge N, B and K of 44 minutes at 50 Hz; only N where the disturbance is slow noise itself."""
    rng = np.random.default_rng([seed, 1])
    t = np.arange(1 << 17) / 50.0
    gyro = np.stack([gyro_noise(len(t), 0.02, rng, **ALLAN) for _ in range(3)], axis=1)
    t, gyro, accel = disturb(name, t, gyro + 0.003, gravity(rng, len(t)), rng, 1e-4)
    result = characterise_standstill_noise(
        read_standstill_channel(recording(t, gyro, accel), "imu", "gz", log="log", cut_disturbances=True)
    )
    judged = "NBK" if name in ("vibration lines", "bias step") or name not in ADDED else "N"
    terms = {key: result.fit.terms[key] for key in judged}
    truth = dict(zip("NBK", ALLAN.values(), strict=True))
    pulls = [(x.value - truth[key]) / x.sigma for key, x in terms.items() if x.value is not None]
    return Answer(pulls, result.notes)


def warmup(name, seed, **_):
    """Judge the forecast at the end of an hour's record at 5 Hz, and half an hour later."""
    rng = np.random.default_rng([seed, 2])
    seconds = 5400
    at, bias, _ = warm_ups.warm_up("one exponential", "", seconds + 31, rng)
    t = np.arange(5 * seconds) / 5.0
    size = 0.02 * DEG
    added = np.stack(
        [ADDED[name](t, rng, size) if name in ADDED else np.zeros(len(t)) for _ in range(3)], axis=1
    )
    true = np.interp(t, at, bias)[:, None] * DEG
    current = slice(0, 5 * 3600)
    gyro = true[current] + added[current] + 0.1 * DEG * rng.standard_normal((5 * 3600, 3))
    times, gyro, accel = disturb(
        name if name in CHANGES else "none", t[current], gyro, gravity(rng, 5 * 3600), rng, size
    )
    true = -true if name == "axes reversed" else true + added * (name in BIASES)
    result = characterise_standstill_warmup(
        read_standstill_channel(recording(times, gyro, accel), "imu", "gz", log="log")
    )
    ages = np.array([times[-1] - 20.0, min(times[-1] + 1800.0, seconds - 20.0)])
    mean, sigma = result.forecast.predict(ages)
    at = ages / clock_rate(name)
    truth = np.array([true[(t > age - 15) & (t < age + 15), 2].mean() for age in at])
    return Answer(list((mean - truth) / sigma), result.remarks)


def north(name, seed, latitude=45.0, given=None, programme=None, method="maytag4", **world):
    """Judge the azimuth of twelve stops of 20 s, with table angles from the gyro."""
    rng = np.random.default_rng([seed, 3])
    azimuth, scale = rng.uniform(-np.pi, np.pi), 0.01 * rng.standard_normal()
    t, gyro, accel, _ = table_record(
        programme or even(), rng, azimuth=azimuth, latitude=latitude * DEG, noise=NOISE, scale=scale, **world
    )
    node = recording(*disturb(name, t, gyro, accel, rng, 15 * DEG_H))
    options = NorthOptions(latitude if given is None else given, ["x"], method)
    result = north_from_recordings([("log", node)], ["imu"], options)
    error = (result.azimuth - azimuth + np.pi) % (2 * np.pi) - np.pi
    return Answer([error / result.sigma], result.warnings)


def heading(name, seed, thermometer=False, **world):
    """Judge the final heading of five minutes of turns between two standstills.

    thermometer: the room warms or cools by 3 °C and back, and the log has its temperature; 0.02 deg/s per °C.
    """
    world = {"standstills": (0, 9)} | world
    t, gyro, accel, true = steady_turns([seed, 4], scale_sigma=0.01, **world)
    rng = np.random.default_rng([seed, 5])
    times, gyro, accel = disturb(name, t, gyro, accel, rng, 0.02 * DEG)
    temperature = None
    if thermometer:
        temperature = 25.0 + ramp_and_return(t, rng, 1.0)
        gyro = gyro + np.outer(temperature - 25.0, 0.02 * DEG * rng.standard_normal(3))
    sign = -1 if name == "axes reversed" else 1
    result = heading_from_recording(
        recording(times, gyro, accel, temperature), "imu", HeadingOptions(), log="log"
    )
    truth = sign * np.interp(t[0] + (result.track.t[-1] - t[0]) / clock_rate(name), t, true)
    return Answer([(result.track.heading[-1] - truth) / result.track.sigma[-1]], result.notes)


def clock_rate(name):
    return FAST_CLOCK if name == "clock 1 % fast" else 1.0


TITLES = {
    "allan": "allan: N, B and K of 44 minutes at 50 Hz",
    "warmup": "warmup: forecast at the end of an hour at 5 Hz, and half an hour later",
    "north": "north: twelve stops of 20 s, angles from the gyro",
    "heading": "heading: five minutes of steady turns between two standstills",
}
VERBS = {"allan": allan, "warmup": warmup, "north": north, "heading": heading}


def numberless(note):
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", note)


def usual_notes(judge, seeds):
    """Return the beginnings of the notes on records without disturbance."""
    notes = set()
    for seed in seeds:
        with suppress(HubodoError):
            notes |= {numberless(note)[:40] for note in judge("none", seed).notes}
    return notes


def print_row(verb, name, seeds, usual, judge, row):
    pulls, warned, valid, silent, reasons, examples = [], 0, 0, [], {}, {}
    for seed in seeds:
        try:
            answer = judge(row[0], seed, **row[1])
        except HubodoError as error:
            reasons[numberless(str(error))[:90]] = reasons.get(numberless(str(error))[:90], 0) + 1
            continue
        pulls += answer.pulls
        new = [note for note in answer.notes if numberless(note)[:40] not in usual or names_cause(row, note)]
        for note in new:
            examples.setdefault(numberless(note)[:90], note)
        wrong = any(not abs(z) < 4 for z in answer.pulls)
        warned += bool(new)
        valid += not wrong
        if wrong and not new:
            silent.append(seed)
    refused = sum(reasons.values())
    print(
        f"{verb:8s}{name:22s} valid {valid:2d} warned {warned:2d} refused {refused:2d} silently wrong "
        f"{len(silent):2d}  {coverage(pulls)}",
        flush=True,
    )
    return silent, reasons, examples


def names_cause(row, note):
    """Return True if a note that any record may have names the disturbance of this one as its assumption.

    Nothing confirms the signs of reversed axes; a bias that changes only in motion shows in no standstill.
    """
    signs = row[0] == "axes reversed" and "nothing confirms the signs" in note
    return signs or (row[0] in BIASES and "the bias is assumed to be stable while the sensor moves" in note)


def coverage(pulls):
    if not pulls:
        return ""
    count, hits = len(pulls), int(np.sum(np.abs(pulls) < 1.96))
    low = beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{hits / count:5.3f} [{low:.3f}, {high:.3f}]"


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    parser.add_argument("--only", choices=VERBS)
    parser.add_argument("--rows", default="")
    parser.add_argument("--why", action="store_true")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    start = time.process_time()
    print(f"seeds {seeds[0]} to {seeds[-1]}")
    for verb, judge in VERBS.items():
        if args.only not in (None, verb):
            continue
        print(TITLES[verb])
        usual = usual_notes(judge, seeds[:5])
        for name, row in (SHARED_ROWS | EXTRA_ROWS.get(verb, {})).items():
            if args.rows in name:
                silent, reasons, examples = print_row(verb, name, seeds, usual, judge, row)
                if args.why:
                    print("    silent", silent, "refused", reasons, "notes", list(examples.values())[:4])
    print(f"processor {time.process_time() - start:.0f} s")


if __name__ == "__main__":
    main()
