"""Odometer of one or two wheels: samples in, poses out, bit-identical live and in bulk.

Samples are integrated over windows of 0.1 s (`preintegration.py`), independently of all estimates. The
filter takes one step per window (`filter_core.py`). So a whole log and a stream of single samples give
bit-identical poses. No clock, file or thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.live_state import LiveExtrapolation
from hubodo.fuse.wheel.preintegration import SampleBlock, WheelSample, WindowBuilder
from hubodo.fuse.wheel.records import Pose, SmoothingTerms, StepInput
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.thresholds import SETTLING_WINDOWS
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOWS_PER_SECOND, Window

ALIGNMENT_WINDOWS = WINDOWS_PER_SECOND
"""Windows from which wheel angles are initialised before the first pose: no vehicle brakes or turns all the
time."""

_MAX_NODE_DELAY_WINDOWS = WINDOWS_PER_SECOND
"""Windows by which a node may lag behind the other before its windows are missing."""

_MAX_STEPS_PER_SAMPLE = 3
"""Steps taken at most for one sample; the rest waits for the next windows. When a late node is received
again,
and at the first pose, ten are due; they take half a second."""


_MAX_SPEED_DELAY_WINDOWS = 2
"""Windows for which a step waits for surface speeds that arrive live: encoders report ten times a second or
more often. The state at the newest sample is extrapolated meanwhile."""

_MAX_SPEED_OUTAGE_WINDOWS = SETTLING_WINDOWS
"""Windows without surface speeds after which no step waits for them."""


@dataclass(frozen=True, slots=True)
class FilterOutput:
    """Result of processing samples.

    Attributes
    ----------
    poses : poses of the windows that the samples completed.
    n_rejected : number of samples left out because their time did not increase, their rate jumped and
    returned, or their node is on no wheel.
    """

    poses: tuple[Pose, ...] = ()
    n_rejected: int = 0


class WheelFilter:
    """Wheel odometry: pass samples to `handle`, or blocks to `handle_blocks`, then call `finish`.

    Poses are returned as windows close. The windows of a node that lags a second behind the other are
    dropped. An outage of all nodes is one step with one pose at its end, however long it is.
    """

    def __init__(self, config: WheelConfig, speeds: SurfaceSpeeds | None = None) -> None:
        """Start the filter; speeds: surface speeds of another odometer, if the config is encoder-aided."""
        self.config = config
        self._speeds = dict(speeds or {})
        self._next_speed_number: int | None = None  # None if speeds do not arrive live
        self.core = FilterCore(config)
        self.recorded_steps: list[StepInput] | None = None
        self.smoothing_terms: list[SmoothingTerms] | None = None
        self._builders = {
            name: WindowBuilder(node.facing, 0.0, node.gyro_limit, node.accel_limit)
            for name, node in config.nodes.items()
        }
        self._queues: dict[str, deque[Window]] = {name: deque() for name in config.nodes}
        self._next_number: int | None = None
        self._unaligned: list[StepInput] = []
        self._due: deque[StepInput] = deque()
        self._is_aligned = False
        self._live = LiveExtrapolation()

    def record_for_smoothing(self) -> None:
        """Record all steps, and their smoothing terms as long as a second pass would repeat them."""
        self.recorded_steps, self.smoothing_terms = [], []
        self.core.changes = []

    def handle(self, sample: WheelSample) -> FilterOutput:
        """Process one sample; samples of different nodes may come in any order."""
        builder = self._builders.get(sample.node)
        if builder is None:
            return FilterOutput(n_rejected=1)
        n_rejected_before = builder.n_rejected
        windows = builder.add(sample.t, sample.gyro, sample.accel, sample.beyond_range)
        n_rejected = builder.n_rejected - n_rejected_before
        if builder.newest_t == sample.t:
            self._live.add(sample)
        if windows:
            self._queues[sample.node].extend(windows)
            self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(_MAX_STEPS_PER_SAMPLE) if windows else (), n_rejected)

    def handle_blocks(self, blocks: Mapping[str, SampleBlock]) -> FilterOutput:
        """Process a block of each node over the same time, by name."""
        n_rejected = 0
        for name, block in blocks.items():
            builder = self._builders.get(name)
            if builder is None:
                n_rejected += len(block[0])
                continue
            n_rejected_before = builder.n_rejected
            self._queues[name].extend(builder.add_many(*block))
            n_rejected += builder.n_rejected - n_rejected_before
        self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(), n_rejected)

    def add_surface_speeds(self, speeds: SurfaceSpeeds, next_number: int) -> FilterOutput:
        """Add surface speeds of complete windows; next_number: first window whose speeds are due later."""
        first = self._next_number or 0
        self._speeds = {number: pair for number, pair in self._speeds.items() if number >= first} | speeds
        self._next_speed_number = next_number
        self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(_MAX_STEPS_PER_SAMPLE))

    def finish(self) -> FilterOutput:
        """Process the windows that still wait for a node or the alignment; called after the last sample."""
        self._collect_steps(0)
        self._align()
        return FilterOutput(self._take_steps())

    def state(self) -> Pose | None:
        """Return the pose at the newest sample; None before the first pose."""
        return self._live.state(self.core)

    def set_pose_exact(self) -> None:
        """Declare position and heading of the newest pose exact; their covariance grows from here on."""
        self.core.set_pose_exact()
        pose = self._live.pose
        if pose is not None:
            covariance = pose.covariance.copy()
            covariance[:3, :] = covariance[:, :3] = 0.0
            self._live.pose = pose._replace(covariance=covariance)

    @property
    def rejected_samples(self) -> dict[str, int]:
        """Return the number of samples left out, by node."""
        return {name: builder.n_rejected for name, builder in self._builders.items()}

    @property
    def glitches(self) -> dict[str, int]:
        """Return the number of samples left out because the rate jumped and returned, by node."""
        return {name: builder.n_glitches for name, builder in self._builders.items()}

    def _collect_steps(self, max_delay: int) -> None:
        """Combine the windows of all nodes into steps; a node may lag by `max_delay` windows."""
        queues = list(self._queues.values())
        while any(queues):
            if self._next_number is not None:
                for queue in queues:
                    _drop_before(queue, self._next_number)
            filled = [queue for queue in queues if queue]
            if not filled or (len(filled) < len(queues) and max(map(len, filled)) <= max_delay):
                break
            number = min(queue[0].number for queue in filled)
            if max_delay and self._should_await_speeds(number, max(queue[-1].number for queue in filled)):
                break
            if self._next_number is not None and number > self._next_number:
                self._align()
                self._add_outage(self._next_number, number)
            windows = tuple([_pop_window(queue, number) for queue in queues])
            step = StepInput(windows, number, self._is_aligned, surface_speeds=self._speeds.get(number))
            (self._due if self._is_aligned else self._unaligned).append(step)
            if len(self._unaligned) >= ALIGNMENT_WINDOWS:
                self._align()
            self._next_number = number + 1

    def _should_await_speeds(self, number: int, newest: int) -> bool:
        """Return True if the surface speeds of window `number` are due to arrive soon."""
        due = self._next_speed_number
        return (
            due is not None
            and due <= number < due + _MAX_SPEED_OUTAGE_WINDOWS
            and newest < number + _MAX_SPEED_DELAY_WINDOWS
        )

    def _add_outage(self, first: int, end: int) -> None:
        """Add steps for windows `first` to `end` without any node, split where there are surface speeds."""
        measured = [number for number in range(first, end) if number in self._speeds] if self._speeds else []
        for number in measured:
            if number > first:
                self._due.append(StepInput((), number - 1, True, number - first))
            windows = (EMPTY_WINDOW,) * len(self._queues)
            self._due.append(StepInput(windows, number, True, surface_speeds=self._speeds[number]))
            first = number + 1
        if end > first:
            self._due.append(StepInput((), end - 1, True, end - first))

    def _align(self) -> None:
        """Initialise the filter from the windows so far, once."""
        if self._unaligned:
            self._is_aligned = True
            self.core.align([step.windows for step in self._unaligned])
            self._due.extend(self._unaligned)
            self._unaligned = []

    def _take_steps(self, max_steps: int | None = None) -> tuple[Pose, ...]:
        """Take the steps that are due, `max_steps` of them at most."""
        poses = []
        for _ in range(len(self._due) if max_steps is None else min(max_steps, len(self._due))):
            step = self._due.popleft()
            if self.recorded_steps is not None:
                self.recorded_steps.append(step)
            poses.append(self.core.step(step, ALIGNMENT_WINDOWS))
            if self.smoothing_terms is not None:
                self.smoothing_terms.append(self.core.newest_terms)
                if not self.core.is_single_pass:
                    self.smoothing_terms = self.core.changes = None
        if poses:
            self._live.start(poses[-1])
        return tuple(poses)


def _drop_before(queue: deque[Window], number: int) -> None:
    """Drop windows before `number`."""
    while queue and queue[0].number < number:
        queue.popleft()


def _pop_window(queue: deque[Window], number: int) -> Window:
    """Remove window `number` of a node from its queue; return an empty one if it is not there."""
    return queue.popleft() if queue and queue[0].number == number else EMPTY_WINDOW
