"""Which topic of a log is which node or file: as the user says, else by type, never by a silent choice."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hubodo.errors import InputError
from hubodo.log import ros2, topics
from hubodo.recording import TABLE_FILE_COLUMNS
from hubodo.toml_file import suggest_spelling

NODES = "nodes"
TYPES: Mapping[str, tuple[str, ...]] = {
    "gnss": (ros2.NAV_SAT_FIX,),
    "reference": (ros2.ODOMETRY, ros2.TWIST_STAMPED, ros2.TWIST_WITH_COVARIANCE_STAMPED),
    "wheels": (ros2.JOINT_STATE,),
    "heading": (ros2.IMU, ros2.ODOMETRY),
    "truth": (ros2.ODOMETRY,),
}
"""The message types that each file can be made of; a node is made of `ros2.IMU`."""
ALL_ROLES = frozenset({NODES, *TYPES})
LEFT_OUT = "-"


@dataclass(frozen=True)
class TopicChoice:
    """What the user says of a log's topics.

    said: by --topic, role or node to topic, "-" to leave it out; one that is not there is refused. known: the
    same of `[topics]` in the vehicle file, where one that is not there is told. nodes: of the vehicle, and
    whether on a wheel. wheel_radius: m. needed: the roles of which two candidates are refused, not told.
    """

    said: Mapping[str, str] = field(default_factory=dict)
    known: Mapping[str, str] = field(default_factory=dict)
    nodes: Mapping[str, bool] = field(default_factory=dict)
    wheel_radius: float | None = None
    needed: frozenset[str] = ALL_ROLES

    def __bool__(self) -> bool:
        return bool(self.said or self.known)


BY_TYPE = TopicChoice()
"""Nothing is said."""


@dataclass(frozen=True)
class RoleTopic:
    """A topic with messages: their type, and of joint states the joints that have a speed."""

    kind: str
    joints: tuple[str, ...] = ()


@dataclass(frozen=True)
class Roles:
    """What was settled. nodes, files: name to topic. joints: left, right. notes: what was not, and why."""

    nodes: Mapping[str, str]
    files: Mapping[str, str]
    joints: tuple[str, str] | None
    notes: tuple[str, ...]


def assign(found: Mapping[str, RoleTopic], choice: TopicChoice, *, ours: bool, where: str) -> Roles:
    """Give each topic its role.

    found: by topic. ours: hubodo wrote the log, so names count and not types. Raises InputError for a --topic
    that is not there or of another type, and where a role that is needed has several candidates.
    """
    return _Assignment(found, choice, ours, where).roles()


class _Assignment:
    def __init__(self, found: Mapping[str, RoleTopic], choice: TopicChoice, ours: bool, where: str) -> None:
        self.found, self.choice, self.ours, self.where = found, choice, ours, where
        self.notes: list[str] = []
        self.picked: dict[str, tuple[str, ...]] = {}
        self.dropped: set[str] = set()
        self.joints: tuple[str, str] | None = None

    def roles(self) -> Roles:
        stated = self._stated()
        files = {role: topic for role, topic in stated.items() if role in TYPES}
        nodes = {name: topic for name, topic in stated.items() if name not in TYPES}
        for role in TYPES:
            if role not in files and role not in self.dropped:
                topic = self._by_type(role, set(stated.values()))
                if topic is not None:
                    files[role] = topic
        if "wheels" in files:
            self.joints = self._pair(files["wheels"], self.picked.get("wheels", ()))
            if self.joints is None:
                del files["wheels"]
        return Roles(self._nodes(nodes, set(stated.values())), files, self.joints, tuple(self.notes))

    def _stated(self) -> dict[str, str]:
        """What --topic and [topics] say, as far as it is there."""
        made: dict[str, str] = {}
        for name, text in {**self.choice.known, **self.choice.said}.items():
            by_user = name in self.choice.said
            if text == LEFT_OUT:
                self.dropped.add(name)
                continue
            topic, _, joints = text.partition(":")
            topic = topic if topic in self.found else "/" + topic if "/" + topic in self.found else topic
            kinds = TYPES.get(name, (ros2.IMU,))
            if topic not in self.found:
                fitting = [it for it, candidate in self.found.items() if candidate.kind in kinds]
                words = (
                    f"{name}={topic}: no such topic with messages that are understood"
                    f"{suggest_spelling(topic, self.found)}; "
                    f"of its type there are {', '.join(fitting) or 'none'}"
                )
                if by_user:
                    raise InputError(f"{self.where}: --topic {words}")
                if not self.ours:
                    self.notes.append(f"[topics] {words}")
                continue
            if self.found[topic].kind not in kinds:
                raise InputError(
                    f"{self.where}: --topic {name}={topic}: is {self.found[topic].kind}; {name} is made of "
                    f"{' or '.join(kinds)}"
                )
            self.picked[name] = tuple(part for part in joints.split(",") if part)
            made[name] = topic
        return made

    def _by_type(self, role: str, claimed: set[str]) -> str | None:
        """The only topic of a role's types; None where there is none, or several that do not matter."""
        own = {"gnss": topics.FIX, "truth": topics.TRUTH}.get(role, "")
        if own in self.found and (self.ours or role == "truth") and self.found[own].kind in TYPES[role]:
            return own
        if self.ours or role in ("truth", "heading"):
            return None
        candidates = [
            topic
            for topic, candidate in self.found.items()
            if candidate.kind in TYPES[role] and topic not in claimed and self._likely(role, topic, candidate)
        ]
        if len(candidates) <= 1:
            return candidates[0] if candidates else None
        listed = ", ".join(f"{topic} ({self.found[topic].kind})" for topic in candidates)
        self._undecided(
            role, f"{listed} could each be {role}; add --topic {role}={candidates[0]}, or {role}=- for none"
        )
        return None

    def _likely(self, role: str, topic: str, candidate: RoleTopic) -> bool:
        """Commands are no measurements, the truth is no reference, and joints of an arm are no wheels."""
        if role == "reference":
            return topic != topics.TRUTH and not {"cmd", "command", "cmds"} & _words(topic)
        return role != "wheels" or all(_on_side(candidate.joints, side) for side in ("left", "right"))

    def _pair(self, topic: str, picked: tuple[str, ...]) -> tuple[str, str] | None:
        """The joints of the left and the right wheel."""
        joints = self.found[topic].joints
        if len(picked) == 2 and set(picked) <= set(joints):
            return picked[0], picked[1]
        sides = [_on_side(joints, side) for side in ("left", "right")]
        if not picked and all(len(side) == 1 for side in sides):
            return sides[0][0], sides[1][0]
        asked = f"--topic wheels={topic}:{','.join(side[0] if side else 'JOINT' for side in sides)}"
        self._undecided(
            "wheels",
            f"{topic} has the joints {', '.join(joints) or 'without speeds'}; say which turns left and which "
            f"right: {asked}, or wheels=- for none",
            refuse=bool(picked) or topic in self.choice.said.get("wheels", ""),
        )
        return None

    def _undecided(self, role: str, words: str, *, refuse: bool = False) -> None:
        if refuse or role in self.choice.needed:
            raise InputError(f"{self.where}: {words}")
        self.notes.append(words)

    def _nodes(self, stated: Mapping[str, str], claimed: set[str]) -> dict[str, str]:
        """Node name to topic: as stated, then by the vehicle's names, the rest by their topics."""
        made = dict(stated)
        free = [
            topic
            for topic, candidate in self.found.items()
            if candidate.kind == ros2.IMU and topic not in claimed
        ]
        if not self.ours:
            self._vehicle_nodes(made, free)
        for topic in free:
            name = node_name(topic)
            if name in self.dropped:
                continue
            while name in made or name in TABLE_FILE_COLUMNS:
                name += "_"
            made[name] = topic
        return made

    def _vehicle_nodes(self, made: dict[str, str], free: list[str]) -> None:
        """Moves those topics from free to made that can only be one node of the vehicle."""
        names = {node_name(topic) for topic in free}
        open_nodes = [it for it in self.choice.nodes if it not in {*made, *names, *self.dropped}]
        fits = {
            node: [topic for topic in free if _words(node) <= _words(topic) and node_name(topic) not in made]
            for node in open_nodes
        }
        several = {node: fit for node, fit in fits.items() if len(fit) > 1}
        if len(self.choice.nodes) == len(free) == len(open_nodes) == 1:
            fits = {open_nodes[0]: list(free)}
        for node, fit in fits.items():
            if len(fit) == 1 and sum(fit[0] in other for other in fits.values()) == 1:
                made[node] = fit[0]
                free.remove(fit[0])
                self.notes.append(f"node {node} is taken to be {fit[0]}; --topic {node}=... says another")
        missing = [node for node in open_nodes if node not in made]
        found_none = not any(node in made or node in names for node in self.choice.nodes)
        if missing and free and (several or found_none):
            node = next(iter(several), missing[0])
            listed = several.get(node, free)
            self._undecided(
                NODES,
                f"{', '.join(listed)} ({ros2.IMU}) could each be node {node}; add --topic {node}={listed[0]}",
            )
        elif missing and free:
            self.notes.append(
                f"no topic is named like node {missing[0]}, not used for it: {', '.join(free)}; "
                f"--topic {missing[0]}={free[0]} would"
            )


def node_name(topic: str) -> str:
    """A node's name from its topic: `/left/imu` is `left`, `/imu/data_raw` is `imu_data_raw`."""
    return topic.strip("/").removesuffix("/imu").replace("/", "_") or "imu"


def _words(text: str) -> set[str]:
    """`/imu/leftWheel2` has the words imu, left, wheel, 2."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", text)}


def _on_side(joints: Iterable[str], side: str) -> tuple[str, ...]:
    """The joints of one side; where some of them are called wheels, those."""
    there = [joint for joint in joints if {side, side[0]} & _words(joint)]
    wheels = [joint for joint in there if "wheel" in joint.lower()]
    return tuple(wheels or there)
