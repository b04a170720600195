"""Command lines that together exercise every option of every verb, and the files that they need."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from example_effect import HUM
from hubodo.ingest.link.keys import KeyRing
from in_process import hubodo
from vehicles import DRIVE_MODEL, LOW_INPUT_NOISE, vehicle_toml


@dataclass(frozen=True)
class Run:
    """Command lines separated by ` ; `, with the exit code of the last one and a text of its stderr.

    {n} stands for the number of the run, {port} for the port of a fake node.
    """

    command_lines: str
    code: int = 0
    message: str = ""


def _logs(
    verb: str, needs: str = "", code: int = 0, message: str = "", bag: int | None = None
) -> tuple[Run, Run]:
    """Return runs for the options of a verb that reads logs: a number file, and topics of a foreign log.

    bag: the exit code for the foreign log, if different.
    """
    numbers = (
        "numbers.npz --variable gyro,accel --rate 100 --unit rad/s --unit m/s^2 --columns gx,gy,gz,ax,ay,az "
        "--zero 0 --scale gyro=1"
    )
    return (
        Run(f"{verb} {numbers} {needs} --max-memory 900 --json --debug", code, message),
        Run(
            f"{verb} bag --topic left=/left/imu --topic right=- {needs}",
            code if bag is None else bag,
            message,
        ),
    )


_STILL = "--start 1 --end 19 --trust-units --trust-still"
_CERTIFICATE = "--token-file token --cert cert.pem --key key.pem"

RUNS: tuple[Run, ...] = (
    *_logs("info"),
    *_logs("allan"),
    Run(
        f"allan rest.mcap --node left --channel gx --force {_STILL} --datasheet MPU-6050 --turn 3 "
        "--per-octave 2 --figure out-{n}.svg --report out-{n}.html --units common"
    ),
    Run("allan rest.mcap --node left --as-is --also hadamard,psd --report out-{n}.html"),
    Run("allan rest.mcap --node left --kalibr out-{n}.yaml --imu-filter out-{n}-filter.yaml"),
    *_logs("warmup", "", 2, "too short for a warm-up"),
    Run(
        f"warmup rest.mcap --node left --channel gx --force {_STILL} --age 1 --at 60 -o out-{{n}}.toml "
        "--form exponential --figure out-{n}.svg --report out-{n}.html --units common",
        2,
        "too short for a warm-up",
    ),
    *_logs("calibrate imu", "--node left -o out-{n}.toml", 2),
    Run(
        "calibrate imu poses.mcap --node left --gravity 9.81 --latitude-deg 48 --convention x-first "
        "--temperature-order 0 "
        "--min-rest 0.5 --force --report out-{n}.html -o out-{n}.toml --units common"
    ),
    Run(
        "calibrate rate turned.csv --node turned --unit rad/s --table rates.csv --settle 0.5 "
        "--full-scale-deg-s 250 --latitude-deg 48 -o out-{n}.toml --units si"
    ),
    Run(
        "calibrate plan --noise-density 0.002 --bias-instability 1e-4 --bias-sigma 0.002 --turn 3 --units si"
    ),
    Run("calibrate plan --noise-density 0.002 --json --report out-{n}.html --force"),
    Run("calibrate plan --allan missing.json", 1, "missing.json"),
    *_logs("calibrate rate", "--axis x --rates-deg-s=0,50 -o out-{n}.toml", 2),
    Run(
        "calibrate rate turned.csv --node turned --unit rad/s --rates-deg-s=0,50 --min-plateau 2 "
        "-o out-{n}.toml",
        2,
        "2 rates are listed",
    ),
    Run("calibrate imu means.csv --node left --means --mean-sigma 1e-3 -o out-{n}.toml"),
    Run(
        "calibrate imu poses.mcap --node left --table-rate-deg-s 10 -o out-{n}.toml",
        2,
        "no steady turn",
    ),
    _logs("sheet --still", "-o out-{n}")[0],
    _logs("sheet --warmup", "-o out-{n}", 2, "too short for a warm-up")[1],
    Run(
        "sheet --poses poses.mcap --warmup rest.mcap --age 1 --node left --gravity 9.81 --latitude-deg 48 "
        "--force -o out-{n} --units si",
        2,
        "too short for a warm-up",
    ),
    Run("sheet --poses means.csv --means -o out-{n}"),
    Run("sheet --still rest.mcap --means -o out-{n}", 2, "--means belongs to --poses"),
    *_logs("calibrate wheels", "--vehicle vehicle.toml -o out-{n}.toml", 2),
    Run(
        "calibrate wheels drive.mcap --vehicle vehicle.toml -o out-{n}.toml --radius-sigma 0.03 "
        "--track-sigma 0.04 --scale-sigma 0.02 --report out-{n}.html --force --units si"
    ),
    *_logs("north", "--latitude-deg 48", 2),
    Run(
        "north table.mcap --latitude-deg 48 --node left --axis y --method east --near-deg 10 --settle 1 "
        "--find-stops --force --step-deg 90 --scale-sigma 0.02 --calibration calibration.toml "
        "--figure out-{n}.svg --report out-{n}.html",
    ),
    Run("north rest.mcap --latitude-deg 48 --node left --plan --sigma-deg 2 --turn 3 --units si"),
    Run("north --latitude-deg 48 --plan --allan allan.json"),
    Run("north rest.mcap --latitude-deg 48 --node left --simulate-azimuth-deg 20 --stop 1 --stops 4", 2),
    Run(
        "north --latitude-deg 48 --live missing --table missing --node left --resume table.mcap --stops 4 "
        "--stop 5 -o out-{n}.mcap",
        1,
        "missing",
    ),
    *_logs("heading", "-o out-{n}.csv", bag=2),
    Run(
        "heading upright.mcap --force --node numbers --allan allan.json --age 10 --rest 0 1 "
        "--scale-sigma 0.02 --lag 0.01 --step 0.2 -o out-{n}.csv --figure out-{n}.svg --report out-{n}.html "
        "--units si"
    ),
    Run(
        "heading rest.mcap --node left --axis x --calibration calibration.toml -o out-{n}.csv", 2, "vertical"
    ),
    *_logs("filters"),
    Run(
        "filters drive.mcap --node left --reference reference.speed --rest 0 1 --start 0 --end 20 "
        "--figure out-{n}.svg --report out-{n}.html --units si"
    ),
    Run("filters rest.mcap --node left --channel gx --force"),
    *_logs("fuse", "--vehicle vehicle.toml -o out-{n}", 2, bag=0),
    Run(
        "fuse drive.mcap --vehicle vehicle.toml --calibration calibration.toml --effects hum.py "
        "--candidates field --nodes left --smooth 1 --no-graph --antenna 0.5 0 -o out-{n} --force"
    ),
    Run("fuse drive.mcap --vehicle vehicle.toml --method differential -o out-{n}"),
    *_logs("gap model.toml", "-o out-{n}", 2),
    Run(
        "gap model.toml drive.mcap -o out-{n} --accept wheel_camber --reject empirical "
        "--explain wheel_radius",
    ),
    Run("gap drive.mcap --vehicle vehicle.toml -o out-{n} --force --resume --scaffold hiss", 2),
    Run(
        "gap model.toml --before drive.mcap --after missing.mcap --candidates field "
        "--effects hum.py -o out-{n}",
        2,
    ),
    *_logs("report", "-o out-{n}.html"),
    Run(
        "report moment.mcap --vehicle vehicle.toml --calibration calibration.toml --gravity 9.81 --force "
        "-o out-{n}.html"
    ),
    *_logs("play", "--speed 0"),
    Run("play drive.mcap --speed 0 --start 1 --end 2 --vehicle vehicle.toml --calibration calibration.toml"),
    Run("play drive.mcap --speed 0 --end 1 --foxglove 127.0.0.1:0"),
    Run("play drive.mcap --to pty --link file --only left", 2),
    *_logs("import", "-o out-{n}.mcap"),
    Run("import csv --force --repair --vehicle vehicle.toml -o out-{n}.mcap"),
    *_logs("export", "-o out-{n}"),
    Run("export rest.mcap --force --format parquet --vehicle vehicle.toml -o out-{n}"),
    Run(
        "fuse drive.mcap --vehicle vehicle.toml -o out-{n} ; "
        "export out-{n} --format gpx --origin 47 8 -o out-{n}.gpx"
    ),
    Run(
        "vehicle new --diameter 33cm --track 55cm --left-facing outwards --right-facing none "
        "--antenna 50cm 0 --latitude-deg 48 --force -o out-{n}.toml ; "
        "vehicle check out-{n}.toml rest.mcap --push 2m",
        2,
        "push further",
    ),
    Run(
        "vehicle new --radius 2m --radius-from tape --track 3cm --unusual-size --log rest.mcap "
        "--push 2m -o out-{n}.toml --right-facing none",
        2,
        "push further",
    ),
    Run("vehicle new --radius 2m --track 3cm -o out-{n}.toml", 2, "unusual"),
    *_logs("vehicle check vehicle.toml", "--push 2m", 2),
    Run("example rest.mcap --force", 2, "is a file"),
    Run("recover rest.mcap --force -o out-{n}.mcap --max-memory 900 --json --debug"),
    Run(
        "simulate model.toml --force --duration 6 --rate 50 --reference-rate 20 --seed 2 --temperature 10 20 "
        "--settle 5 --supply 3.3 --calibration calibration.toml --effects hum.py --candidates field "
        "-o out-{n}.mcap --json --debug"
    ),
    Run(
        "simulate model.toml --drive turntable --duration 50 --latitude-deg 48 --azimuth-deg 10 "
        "--angles-deg 0 90 --stop 10 --turn 3 -o out-{n}.mcap"
    ),
    Run(
        "simulate model.toml --drive reference --from csv --topic left=- --max-memory 900 -o out-{n}.mcap", 2
    ),
    Run(
        "simulate model.toml --virtual-node --interpreter rp2040 --image missing --bootrom missing "
        "-o out-{n}.mcap",
        1,
        "missing",
    ),
    Run(
        "demo -o out-{n} --seed 2 --moving 5 --interpreter rp2040 --image missing --bootrom missing "
        "--json --debug",
        1,
        "missing",
    ),
    Run("service install --root image --dry-run --config hubodo.toml --program /usr/bin/true --json --debug"),
    Run("service install --user --dry-run --config hubodo.toml"),
    Run("config check hubodo.toml --json --debug"),
    Run("config example --output config-{n}.toml --force"),
    Run("completion bash --json --debug"),
    Run(
        "flash missing --node left --rate-hz 104 --set rest_after_s=60 --calibration calibration.toml",
        1,
        "missing",
    ),
    Run("flash missing --fleet fleet.toml --key-file keys.toml --json --debug", 1),
    Run("flash missing --roll-back", 1, "missing"),
    Run("flash --all --roll-back", 2, "board"),
    Run("doctor missing --repl --seconds 3 --baud 9600 --json --debug", 1),
    Run(
        "batch info csv -o out-fleet --workers 1 --memory-limit 2GB --json --debug ; "
        "logs out-fleet --vehicle x --from 2026-01-01 --to 2026-02-01 --search left --json --debug"
    ),
    Run("batch calibrate imu csv --node left -o out-{n} --priors --scheduler nowhere://x", 1),
    Run("serve csv --config hubodo.toml --json --debug"),
    Run(f"serve csv --at 127.0.0.1:0 {_CERTIFICATE}"),
    Run("record {port} -o out-{n}.mcap --duration 1 --quiet --vehicle vehicle.toml --json --debug"),
    Run(f"record {{port}} -o out-{{n}}.mcap --duration 1 --web 127.0.0.1:0 {_CERTIFICATE}"),
    Run(
        "record {port} -o out-{n} --config hubodo.toml --duration 1 --vehicle vehicle.toml --watch-gap "
        "--calibration calibration.toml --effects hum.py --candidates field --time-scale 2"
    ),
    Run(
        "record {port} -o out-{n}.mcap --duration 1 --gnss {port} --baud 115200 --gnss-baud 38400",
        2,
        "give each port once",
    ),
    Run(
        "record {port} -o out-{n}.mcap --duration 1 --foxglove 127.0.0.1:0 --metrics 127.0.0.1:0 --wait "
        "--log-format json"
    ),
    Run("record {port} -o out-{n}.mcap --duration 1 --ros2"),
    Run("record {port} -o out-{n}.mcap --duration 1 --mavlink udpout:127.0.0.1:9", 2, "--vehicle"),
    Run(
        "record {port} -o out-{n}.mcap --duration 1 --rotate-after 60 --rotate-at-mb 5 --disk-budget-mb 50",
    ),
    Run("record udp://127.0.0.1:0 -o out-{n}.mcap --duration 1 --key-file keys.toml --insecure-udp"),
    Run("node {port} info --node-id 1 --baud 115200 --json --debug"),
    Run("node {port} bias --kind rest --samples 2001"),
    Run("node {port} reboot --repl"),
    Run("node udp://127.0.0.1:0 info --key-file missing --insecure-udp", 2, "missing"),
    Run("record ble://hubodo-1 -o out-{n}.mcap --duration 1 --key-file missing --insecure-ble", 2, "missing"),
    Run("node ble://hubodo-1 info --key-file missing --insecure-ble", 2, "missing"),
)


def create_files(folder: Path) -> None:
    """Create the files that the command lines name."""
    (folder / "model.toml").write_text(DRIVE_MODEL + LOW_INPUT_NOISE)
    (folder / "uncalibrated.toml").write_text(
        DRIVE_MODEL + LOW_INPUT_NOISE + "[effects.accel_bias]\nx = 0.3\ny = -0.2\nz = 0.3\n"
    )
    (folder / "vehicle.toml").write_text(vehicle_toml())
    rng, count = np.random.default_rng(1), 2000
    gyro, accel = rng.normal(0.01, 0.002, (count, 3)), rng.normal([0.0, 0.0, 9.81], 0.02, (count, 3))
    np.savez(folder / "numbers.npz", gyro=gyro, accel=accel)
    table = np.c_[np.arange(8) * 4.0, [0, 50, 100, 50, 0, -50, -100, 0]]
    t = np.arange(3200) / 100
    turned = np.radians(table[(t / 4).astype(int), 1]) + rng.normal(0.01, 0.001, 3200)
    np.savetxt(folder / "rates.csv", table, delimiter=",", header="t,rate (deg/s)", comments="")
    np.savetxt(folder / "turned.csv", np.c_[t, turned], delimiter=",", header="t,gz", comments="")
    up = rng.normal(size=(12, 3))
    up *= 9.80665 / np.linalg.norm(up, axis=1)[:, None]
    np.savetxt(
        folder / "means.csv", up * [1.01, 0.99, 1.0] + 0.1, delimiter=",", header="ax,ay,az", comments=""
    )
    np.savetxt(folder / "rated.csv", np.c_[np.degrees(gyro), accel], delimiter=",")
    for command_lines in (
        "model.toml --duration 24 --rate 50 --seed 3 -o drive.mcap",
        "model.toml --drive rest --duration 20 --rate 100 -o rest.mcap",
        "model.toml --drive rest --duration 5 --rate 40 -o moment.mcap",
        "uncalibrated.toml --drive poses --duration 80 --rate 50 -o poses.mcap",
        "model.toml --drive turntable --duration 80 --rate 50 --latitude-deg 48 -o table.mcap",
    ):
        _run("simulate", command_lines, folder)
    _run("export", "rest.mcap --format rosbag2 -o bag", folder)
    _run("export", "drive.mcap -o csv", folder)
    _run("calibrate", "imu poses.mcap --node left -o calibration.toml", folder)
    numbers = (
        "numbers.npz --variable gyro,accel --rate 100 --unit rad/s --unit m/s^2 --columns gx,gy,gz,ax,ay,az"
    )
    _run("import", f"{numbers} -o upright.mcap", folder)
    (folder / "allan.json").write_text(hubodo("allan", folder / "rest.mcap", "--node", "left", "--json").out)
    (folder / "hum.py").write_text(HUM)
    (folder / "hubodo.toml").write_text(
        '[record]\nports = ["missing"]\n[web]\nlisten = "127.0.0.1:0"\ntoken_file = "token"\n'
    )
    (folder / "fleet.toml").write_text('[nodes]\ne6614103e7452d2f = "left"\n')
    (folder / "token").write_text("correct-horse-battery\n")
    KeyRing(folder / "keys.toml", create=True).get_or_create_key("e6614103e7452d2f")
    _write_certificate(folder)
    for secret in ("token", "key.pem"):
        (folder / secret).chmod(0o600)


def _write_certificate(folder: Path) -> None:
    """Write a self-signed certificate and its key in the format of `openssl req -x509`."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    now = datetime.now(UTC)
    certificate = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    certificate = certificate.serial_number(1).not_valid_before(now).not_valid_after(now + timedelta(days=1))
    (folder / "cert.pem").write_bytes(certificate.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    text = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "key.pem").write_bytes(text)


def _run(verb: str, arguments: str, folder: Path) -> None:
    done = hubodo(
        verb,
        *(folder / word if "." in word or word in ("bag", "csv") else word for word in arguments.split()),
    )
    assert done.code == 0, done.err
