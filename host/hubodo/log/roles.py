"""Assign the topics of a log to nodes and tables: as selected by the user, else by unambiguous type."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hubodo.errors import InputError
from hubodo.log import ros2, topics
from hubodo.recording import TABLE_FILE_COLUMNS
from hubodo.spelling import suggest_spelling

NODES_ROLE = "nodes"
ROLE_TYPES: Mapping[str, tuple[str, ...]] = {
    "gnss": (ros2.NAV_SAT_FIX,),
    "reference": (ros2.ODOMETRY, ros2.TWIST_STAMPED, ros2.TWIST_WITH_COVARIANCE_STAMPED),
    "wheels": (ros2.JOINT_STATE,),
    "heading": (ros2.IMU, ros2.ODOMETRY),
    "truth": (ros2.ODOMETRY,),
}
"""Message types accepted for each table role; a node needs `ros2.IMU`."""
ALL_ROLES = frozenset({NODES_ROLE, *ROLE_TYPES})
EXCLUDED = "-"


@dataclass(frozen=True)
class TopicSelection:
    """The user's selection of topics.

    Attributes
    ----------
    explicit : role or node -> topic from --topic; "-" excludes it, and a missing topic is an error.
    configured : the same from `[topics]` of the vehicle file, where a missing topic is a warning.
    node_is_on_wheel : True for each node of the vehicle that is on a wheel, by name.
    wheel_radius : m.
    required_roles : roles for which several candidates are an error instead of a warning.
    """

    explicit: Mapping[str, str] = field(default_factory=dict)
    configured: Mapping[str, str] = field(default_factory=dict)
    node_is_on_wheel: Mapping[str, bool] = field(default_factory=dict)
    wheel_radius: float | None = None
    required_roles: frozenset[str] = ALL_ROLES

    def __bool__(self) -> bool:
        return bool(self.explicit or self.configured)


SELECT_BY_TYPE = TopicSelection()
"""No selection: roles are assigned by message type."""


@dataclass(frozen=True)
class TopicCandidate:
    """A topic with its message type and, for joint states, the joints that have a velocity."""

    message_type: str
    joints: tuple[str, ...] = ()


@dataclass(frozen=True)
class RoleAssignment:
    """The role of each topic.

    Attributes
    ----------
    nodes, files : node or table name -> topic.
    joints : names of the left and right wheel joint, if any.
    notes : one line for each role that could not be assigned.
    """

    nodes: Mapping[str, str]
    files: Mapping[str, str]
    joints: tuple[str, str] | None
    notes: tuple[str, ...]


def assign_roles(
    candidates: Mapping[str, TopicCandidate], selection: TopicSelection, *, is_hubodo: bool, log_name: str
) -> RoleAssignment:
    """Assign a role to each topic.

    candidates: by topic name. is_hubodo: True if hubodo wrote the log, whose topic names decide instead of
    types. Raises InputError if a --topic is missing or of another type, or if a required role is ambiguous.
    """
    return _RoleAssigner(candidates, selection, is_hubodo, log_name).assign()


class _RoleAssigner:
    def __init__(
        self,
        candidates: Mapping[str, TopicCandidate],
        selection: TopicSelection,
        is_hubodo: bool,
        log_name: str,
    ) -> None:
        self.candidates, self.selection, self.is_hubodo, self.log_name = (
            candidates,
            selection,
            is_hubodo,
            log_name,
        )
        self.notes: list[str] = []
        self.stated_joints: dict[str, tuple[str, ...]] = {}
        self.excluded: set[str] = set()
        self.joints: tuple[str, str] | None = None

    def assign(self) -> RoleAssignment:
        stated = self._stated_topics()
        files = {role: topic for role, topic in stated.items() if role in ROLE_TYPES}
        nodes = {name: topic for name, topic in stated.items() if name not in ROLE_TYPES}
        for role in ROLE_TYPES:
            if role not in files and role not in self.excluded:
                topic = self._topic_by_type(role, set(stated.values()))
                if topic is not None:
                    files[role] = topic
        if "wheels" in files:
            self.joints = self._wheel_joints(files["wheels"], self.stated_joints.get("wheels", ()))
            if self.joints is None:
                del files["wheels"]
        return RoleAssignment(
            self._assign_nodes(nodes, set(stated.values())), files, self.joints, tuple(self.notes)
        )

    def _stated_topics(self) -> dict[str, str]:
        """Return the existing topics selected by --topic and [topics]."""
        assigned: dict[str, str] = {}
        for name, text in {**self.selection.configured, **self.selection.explicit}.items():
            by_user = name in self.selection.explicit
            if text == EXCLUDED:
                self.excluded.add(name)
                continue
            topic, _, joints = text.partition(":")
            topic = (
                topic
                if topic in self.candidates
                else "/" + topic
                if "/" + topic in self.candidates
                else topic
            )
            types = ROLE_TYPES.get(name, (ros2.IMU,))
            if topic not in self.candidates:
                fitting = [it for it, candidate in self.candidates.items() if candidate.message_type in types]
                problem = (
                    f"{name}={topic}: no such topic with messages of a known type"
                    f"{suggest_spelling(topic, self.candidates)}; "
                    f"of its type there are {', '.join(fitting) or 'none'}"
                )
                if by_user:
                    raise InputError(f"{self.log_name}: --topic {problem}")
                if not self.is_hubodo:
                    self.notes.append(f"[topics] {problem}")
                continue
            if (message_type := self.candidates[topic].message_type) not in types:
                needed = " or ".join(types)
                raise InputError(
                    f"{self.log_name}: --topic {name}={topic}: is {message_type}; {name} needs {needed}"
                )
            self.stated_joints[name] = tuple(part for part in joints.split(",") if part)
            assigned[name] = topic
        return assigned

    def _topic_by_type(self, role: str, claimed: set[str]) -> str | None:
        """Return the only topic with a type of the role; None if there is none, or several (noted)."""
        own = {"gnss": topics.GNSS_FIX, "truth": topics.TRUTH}.get(role, "")
        if (
            own in self.candidates
            and (self.is_hubodo or role == "truth")
            and self.candidates[own].message_type in ROLE_TYPES[role]
        ):
            return own
        if self.is_hubodo or role in ("truth", "heading"):
            return None
        candidates = [
            topic
            for topic, candidate in self.candidates.items()
            if candidate.message_type in ROLE_TYPES[role]
            and topic not in claimed
            and self._is_plausible(role, topic, candidate)
        ]
        if len(candidates) <= 1:
            return candidates[0] if candidates else None
        listed = ", ".join(f"{topic} ({self.candidates[topic].message_type})" for topic in candidates)
        self._report_ambiguity(
            role, f"{listed} could each be {role}; add --topic {role}={candidates[0]}, or {role}=- for none"
        )
        return None

    def _is_plausible(self, role: str, topic: str, candidate: TopicCandidate) -> bool:
        """Exclude velocity commands and the truth as reference, and joints without sides as wheels."""
        if role == "reference":
            return topic != topics.TRUTH and not {"cmd", "command", "cmds"} & _split_words(topic)
        return role != "wheels" or all(_joints_on_side(candidate.joints, side) for side in ("left", "right"))

    def _wheel_joints(self, topic: str, stated: tuple[str, ...]) -> tuple[str, str] | None:
        """Return the joints of the left and right wheel, or None after noting why."""
        joints = self.candidates[topic].joints
        if len(stated) == 2 and set(stated) <= set(joints):
            return stated[0], stated[1]
        if not stated and (recognised := recognise_wheel_joints(joints)) is not None:
            return recognised
        sides = [_joints_on_side(joints, side) for side in ("left", "right")]
        option = f"--topic wheels={topic}:{','.join(side[0] if side else 'JOINT' for side in sides)}"
        self._report_ambiguity(
            "wheels",
            f"{topic} has the joints {', '.join(joints) or 'without speeds'}; name the left and the "
            f"right wheel: {option}, or wheels=- for none",
            refuse=bool(stated) or topic in self.selection.explicit.get("wheels", ""),
        )
        return None

    def _report_ambiguity(self, role: str, problem: str, *, refuse: bool = False) -> None:
        if refuse or role in self.selection.required_roles:
            raise InputError(f"{self.log_name}: {problem}")
        self.notes.append(problem)

    def _assign_nodes(self, stated: Mapping[str, str], claimed: set[str]) -> dict[str, str]:
        """Return node name -> topic, as stated, else by the vehicle's node names, else by topic name."""
        assigned = dict(stated)
        unassigned = [
            topic
            for topic, candidate in self.candidates.items()
            if candidate.message_type == ros2.IMU and topic not in claimed
        ]
        if not self.is_hubodo:
            self._match_vehicle_nodes(assigned, unassigned)
        for topic in unassigned:
            name = node_name_of_topic(topic)
            if name in self.excluded:
                continue
            while name in assigned or name in TABLE_FILE_COLUMNS:
                name += "_"
            assigned[name] = topic
        return assigned

    def _match_vehicle_nodes(self, assigned: dict[str, str], unassigned: list[str]) -> None:
        """Move the topics that match exactly one node of the vehicle from `unassigned` to `assigned`."""
        names = {node_name_of_topic(topic) for topic in unassigned}
        unmatched = [
            it for it in self.selection.node_is_on_wheel if it not in {*assigned, *names, *self.excluded}
        ]
        matches = {
            node: [
                topic
                for topic in unassigned
                if _split_words(node) <= _split_words(topic) and node_name_of_topic(topic) not in assigned
            ]
            for node in unmatched
        }
        ambiguous = {node: fit for node, fit in matches.items() if len(fit) > 1}
        if len(self.selection.node_is_on_wheel) == len(unassigned) == len(unmatched) == 1:
            matches = {unmatched[0]: list(unassigned)}
        for node, fit in matches.items():
            if len(fit) == 1 and sum(fit[0] in other for other in matches.values()) == 1:
                assigned[node] = fit[0]
                unassigned.remove(fit[0])
                self.notes.append(f"node {node} is taken to be {fit[0]}; --topic {node}=... selects another")
        missing = [node for node in unmatched if node not in assigned]
        found_none = not any(node in assigned or node in names for node in self.selection.node_is_on_wheel)
        if missing and unassigned and (ambiguous or found_none):
            node = next(iter(ambiguous), missing[0])
            listed = ambiguous.get(node, unassigned)
            self._report_ambiguity(
                NODES_ROLE,
                f"{', '.join(listed)} ({ros2.IMU}) could each be node {node}; add --topic {node}={listed[0]}",
            )
        elif missing and unassigned:
            self.notes.append(
                f"no topic is named like node {missing[0]}; select one of {', '.join(unassigned)} with "
                f"--topic {missing[0]}={unassigned[0]}"
            )


def node_name_of_topic(topic: str) -> str:
    """Return the node name for a topic: `left` for `/left/imu`, `imu_data_raw` for `/imu/data_raw`."""
    return topic.strip("/").removesuffix("/imu").replace("/", "_") or "imu"


def _split_words(text: str) -> set[str]:
    """Split a name into lower-case words: `/imu/leftWheel2` into imu, left, wheel, 2."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", text)}


def recognise_wheel_joints(joints: Iterable[str]) -> tuple[str, str] | None:
    """Return the joints of the left and the right wheel by their names; None unless one fits each side."""
    known = tuple(joints)
    left, right = (_joints_on_side(known, side) for side in ("left", "right"))
    return (left[0], right[0]) if len(left) == len(right) == 1 else None


def _joints_on_side(joints: Iterable[str], side: str) -> tuple[str, ...]:
    """Return the joints of one side; if some are named wheels, only those."""
    on_side = [joint for joint in joints if {side, side[0]} & _split_words(joint)]
    wheels = [joint for joint in on_side if "wheel" in joint.lower()]
    return tuple(wheels or on_side)
