"""Fuzz cases of rosbags: ROS 1 bags, and rosbag2 folders with SQLite database and metadata."""

from __future__ import annotations

import random
import tempfile
from functools import cache
from pathlib import Path

import foreign_logs
from fuzz import seeds
from fuzz.case import Case
from fuzz.mutate_bag import compress_database, mutate_database, mutate_metadata, mutate_rosbag1
from fuzz.mutate_mcap import torn
from fuzz.settings import SETTINGS
from fuzz.words import LOG_READERS, at

_MAX_MESSAGES = 250
_BAG_READERS = (
    *LOG_READERS[:4] * 2,
    *LOG_READERS,
    ("export", "LOG", "--format", "rosbag2", "-o", "FOLDER/out"),
    ("import", "LOG", "-o", "FOLDER/out.mcap"),
)


def rosbag1_case(rng: random.Random) -> Case:
    """Return a mutated ROS 1 bag, from a robot's drive or from single messages of each type."""
    data = rng.choice((_robot_bag, seeds.ros1_bag))()
    data = mutate_rosbag1(rng, data)
    return Case(at(rng.choice(_BAG_READERS), "FOLDER/x.bag"), {**SETTINGS, "x.bag": data})


def rosbag2_case(rng: random.Random) -> Case:
    """Return a mutated rosbag2 folder: database, compression or metadata."""
    files = dict(rng.choice((_robot_folder, _small_folder))())
    (name,) = (name for name in files if name.endswith(".db3"))
    choice = rng.random()
    if choice < 0.15:
        mode, data = compress_database(rng, files.pop(name))
        files[name + (".zstd" if mode == "FILE" else "")] = data
        files["metadata.yaml"] = seeds.BAG_METADATA.format(mode=mode, form="zstd").encode()
    elif choice < 0.85:
        files[name] = mutate_database(rng, files[name])
    if choice > 0.7:
        mutate = rng.choice((mutate_metadata, lambda rng, data: bytes(torn(rng, data))))
        files["metadata.yaml"] = mutate(rng, files["metadata.yaml"])
    if rng.random() < 0.1:
        del files["metadata.yaml"]
    bag = {f"bag/{name}": data for name, data in files.items()}
    return Case(at(rng.choice(_BAG_READERS), "FOLDER/bag"), {**SETTINGS, **bag})


def _small_folder() -> dict[str, bytes]:
    metadata = seeds.BAG_METADATA.format(mode="", form="").encode()
    return {"bag_0.db3": seeds.bag_database(), "metadata.yaml": metadata}


@cache
def _robot_bag() -> bytes:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        return foreign_logs.write(Path(folder) / "x", "rosbag", _robot_messages()).read_bytes()


@cache
def _robot_folder() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        bag = foreign_logs.write(Path(folder) / "bag", "rosbag2", _robot_messages())
        return {path.name: path.read_bytes() for path in bag.iterdir()}


@cache
def _robot_messages() -> list[foreign_logs.RosMessage]:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        return foreign_logs.messages(foreign_logs.drive(Path(folder)))[::40][:_MAX_MESSAGES]
