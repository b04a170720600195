"""Files of one gyro with units, columns and times as users state them: right, refused by cause, or wrong.

    python tests/accuracy/stated_inputs.py [--seeds 20] [--first 0]

Each row runs the command line on a file of an independent simulator. Coverage: share of errors within 1.96
sigma, with its binomial 95 % interval. "refused": refusals whose line has the words expected; "other":
refusals without them, and answers where a refusal is due. "ours" and "plain": rms errors of hubodo and of a
plain fit to the same records, in the unit of the row.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import curve_fit

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imu_records import coverage, rms

import hubodo
from generators import start_gyro
from generators.steady_turns import steady_turns
from hubodo.errors import HubodoError
from in_process import hubodo as command
from script_arguments import script_parser

DEG = np.pi / 180


def save(folder, columns, header=()):
    """Write the columns as a CSV file; return its path."""
    path = Path(folder) / "record.csv"
    pd.DataFrame(np.column_stack(columns)).to_csv(path, header=list(header) or False, index=False)
    return path


def answer(*words):
    """Return the JSON of a command; raise HubodoError with its line on stderr."""
    done = command(*words, "--json")
    if done.code:
        raise HubodoError(done.err)
    return json.loads(done.out)


def warmup(seed, folder):
    """Return errors of C1, C2, T and of the bias after a night of the START gyro, once a second, deg/h."""
    t, output = start_gyro.overnight(1.0, 12 * 3600.0, np.random.default_rng([seed, 71]))
    path = save(folder, [output])
    result = answer("warmup", path, "--rate", 1, "--unit", "deg/s", "--at", t[-1])
    terms = {"c1": DEG * start_gyro.C1, "c2": DEG * start_gyro.C2, "time_constant": start_gyro.T}
    pulls = [
        (result[name]["value"] - truth) / result[name]["sigma"]
        for name, truth in terms.items()
        if result[name]
    ]
    last, truth = result["prediction"][0], start_gyro.bias(t[-1])
    error = np.degrees(last["bias"]) - truth
    (level, rise, constant), _ = curve_fit(
        lambda x, a, b, c: a - b * np.exp(-x / c), t, output, p0=(0.0, 0.3, 3600.0)
    )
    plain = level - rise * np.exp(-t[-1] / constant) - truth
    return [*pulls, error / np.degrees(last["sigma"])], 3600 * error, 3600 * plain


def allan(seed, folder):
    """Return the error of N of the START gyro, warm, in a CSV file with times; relative."""
    t, output = start_gyro.overnight(0.05, 1800.0, np.random.default_rng([seed, 72]))
    output = output - start_gyro.bias(t) + start_gyro.bias(43200.0)
    path = save(folder, [t, output], ["t", "gz"])
    result = answer("allan", path, "--unit", "deg/s")["coefficients"]["N"]
    truth = np.hypot(start_gyro.NOISE, start_gyro.STEP / np.sqrt(12)) * DEG * np.sqrt(0.05)
    plain = np.std(np.diff(output)) * DEG * np.sqrt(0.05 / 2) / truth - 1
    return [(result["value"] - truth) / result["sigma"]], result["value"] / truth - 1, plain


def turns(seed):
    t, gyro, _, true = steady_turns([seed, 73], standstills=(0, 4, 9), scale_sigma=0.01)
    return t, np.degrees(gyro[:, 2]), np.degrees(true[-1])


def judge_heading(rate, truth, turned_deg, sigma_deg):
    """Return the result of a row: pulls, error, and error with the bias of the first 28 s; degrees."""
    plain = (rate[1:] - rate[:560].mean()).sum() / 20.0 - truth
    return [(turned_deg - truth) / sigma_deg], turned_deg - truth, plain


def heading_file(*words, columns):
    """Return a row of `heading` on a file with these columns."""

    def row(seed, folder):
        t, rate, truth = turns(seed)
        path = save(folder, [{"t": t, "gz": rate, "-": t}[name] for name in columns])
        result = answer("heading", path, "--columns", ",".join(columns), "--unit", "deg/s", *words)
        return judge_heading(rate, truth, result["turned_deg"]["heading"], result["sigma_deg"])

    return row


def heading_frame(seed, _):
    t, rate, truth = turns(seed)
    frame = pd.DataFrame({"gz (deg/s)": rate}, index=pd.to_timedelta(t, unit="s"))
    track = hubodo.from_frame(frame).heading().track
    return judge_heading(rate, truth, np.degrees(track.heading[-1]), np.degrees(track.sigma[-1]))


def milliseconds(verb):
    """Return a row with times in ms whose column is called t."""

    def row(seed, folder):
        rng = np.random.default_rng([seed, 74])
        t = np.arange(36000) * 50.0
        return answer(verb, save(folder, [t, 0.01 + 0.003 * rng.standard_normal(len(t))], ["t", "gz"]))

    return row


def drive(seed, folder):
    """Run allan on rates of a vehicle in deg/s."""
    t, rate, _ = turns(seed)
    return answer("allan", save(folder, [t, DEG * rate], ["t", "gz"]))


def beyond(seed, folder):
    t, rate, _ = turns(seed)
    return answer("allan", save(folder, [t, DEG * rate], ["t", "gz"]), "--start", 900)


AMBIGUOUS = "a steady turn looks like a standstill"
"""Without gravity and the other axes, a gyro alone cannot always show which segments are standstills."""
ROWS = {
    "warmup, 0.2 deg/s stated, a night": (warmup, ""),
    "allan, 0.2 deg/s stated, half an hour": (allan, ""),
    "heading, one gyro with times": (heading_file(columns=["t", "gz"]), AMBIGUOUS),
    "heading, --columns -,gz --rate 20": (heading_file("--rate", 20, columns=["-", "gz"]), AMBIGUOUS),
    "heading, data frame": (heading_frame, AMBIGUOUS),
    "allan, times in ms": (milliseconds("allan"), "times look like ms"),
    "warmup, times in ms": (milliseconds("warmup"), "times look like ms"),
    "allan, a drive": (drive, "the sensor was moved or frozen in"),
    "allan, --start beyond the record": (beyond, "--start"),
}
"""Function of seed and folder, and the words that a refusal must have."""


def main():
    args = script_parser(__doc__, seeds=20, first=0).parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"seeds {seeds[0]} to {seeds[-1]}; warmup in deg/h, allan relative, heading in degrees")
    print(f"{'':40s} {'refused':>8s} {'other':>6s} {'coverage':>20s} {'ours':>10s} {'plain':>10s}")
    for name, (run, words) in ROWS.items():
        results, refused, other = [], 0, 0
        for seed in seeds:
            with tempfile.TemporaryDirectory() as folder:
                try:
                    result = run(seed, folder)
                except HubodoError as error:
                    named = bool(words) and words in str(error)
                    refused, other = refused + named, other + (not named)
                    continue
            if isinstance(result, dict):
                other += 1
            else:
                results.append(result)
        cells = ""
        if results:
            pulls, ours, plain = zip(*results, strict=True)
            cells = f"{coverage(np.concatenate(pulls)):>20s} {rms(ours):10.3g} {rms(plain):10.3g}"
        print(f"{name:40s} {refused:8d} {other:6d} {cells}", flush=True)


if __name__ == "__main__":
    main()
