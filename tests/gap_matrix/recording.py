"""Files of a case: a CSV folder, model.toml without the hidden effects, and hidden.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import cases
from gap_matrix.cases import Setup
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import Record
from gap_matrix.world import Array


def write(
    setup: Setup,
    hidden: Sequence[Effect],
    folder: Path,
    truth: dict[str, Any],
    records: Mapping[str, Record] | None = None,
) -> None:
    """Write left.csv, right.csv, reference.csv, model.toml and, from `truth` and the effects, hidden.json.

    records: of the nodes, where they are not what the setup with the hidden effects gives.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for node in SIDES:
        made = records[node] if records else cases.record(setup, node, hidden)
        # Seven digits: a step of the gyro is 0.00122 rad/s, and its multiples must stay multiples.
        _table(
            folder / f"{node}.csv",
            "t,gx,gy,gz,ax,ay,az,temperature",
            np.column_stack([made.t, made.values, made.temperature]),
            "%.6f,%.7f,%.7f,%.7f,%.7f,%.7f,%.7f,%.4f",
        )
    _table(
        folder / "reference.csv",
        "t,speed,yaw_rate,temperature",
        cases.reference(setup),
        "%.6f,%.7f,%.7f,%.4f",
    )
    (folder / "model.toml").write_text(model_file(setup), encoding="utf-8")
    noise = {node: asdict(setup.noise[node]) for node in SIDES}
    start = dict(setup.start_angle)
    found = [asdict(effect) for effect in hidden]
    account = {"seed": setup.seed, "hidden": found, **truth, "noise": noise, "start_angle": start}
    (folder / "hidden.json").write_text(json.dumps(account, indent=1), encoding="utf-8")


def model_file(setup: Setup) -> str:
    """Return model.toml: nominal vehicle, declared noise and known effects, nothing hidden."""
    noise = setup.noise[SIDES[0]]
    lines = [
        "[vehicle]",
        f"wheel_radius = {setup.radius}",
        f"track_width = {setup.track}",
        "",
        "[imu]",
        f"gyro_noise = {noise.gyro}",
        f"accel_noise = {noise.accel}",
    ]
    for node in SIDES:
        lines += ["", f"[nodes.{node}]", f'side = "{node}"', f'facing = "{setup.facing[node]}"']
    lines += [
        "",
        "[inputs]",
        'speed = "reference.speed"',
        'yaw_rate = "reference.yaw_rate"',
        f"speed_noise = {setup.speed_noise}",
        f"yaw_rate_noise = {setup.yaw_rate_noise}",
    ]
    for effect in setup.known:
        owner = f"nodes.{effect.scope}." if effect.scope in SIDES else ""
        lines += ["", f"[{owner}effects.{effect.name}]"]
        lines += [f"{key} = {value!r}" for key, value in effect.parameters.items()]
    return "\n".join(lines) + "\n"


def _table(path: Path, header: str, rows: Array, row_format: str) -> None:
    text = "\n".join([row_format] * len(rows)) % tuple((rows + 0.0).ravel().tolist())  # + 0.0: no minus zero
    path.write_text(f"{header}\n{text}\n", encoding="utf-8")
