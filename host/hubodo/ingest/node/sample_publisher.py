"""Dating and logging of what a node measured: held until its clock is known, then published in order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hubodo.ingest.node.bias_filter import filter_report_columns
from hubodo.ingest.node.clock import ClockSync
from hubodo.ingest.node.health import SupplyHistory, read_supply
from hubodo.ingest.node.life_events import lag_event, power_on_event
from hubodo.ingest.node.log_times import LogTimeSequence, RateWindow
from hubodo.ingest.node.outputs import BiasFilterReport, HealthReceived, HighGBlock, MagSample
from hubodo.ingest.node.slewed_times import OVERLAP_SLEW_RATIO, SlewedTimes
from hubodo.log.records import (
    Battery,
    BiasFilterRow,
    EventRecord,
    HighGSamples,
    ImuBlock,
    ImuRun,
    LogRecord,
    MagneticField,
    NodeSamples,
    Sink,
)
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire.messages import Hello, ResetCause

_MAX_CLOCK_WAIT_NS = (
    5 * NS_PER_S
)  # samples are held for the first clock replies; on a starved host they are late
_MIN_CLOCK_REPLIES = 6  # a single reply may be late by a scheduling delay of a busy host
_MAX_INITIAL_SIGMA_NS = NS_PER_S // 4  # above that of any link: the host itself reads late
_MIN_REPORTED_LAG_NS = NS_PER_S // 20  # more than the delay of any link
_REPORTS: tuple[type, ...] = (MagSample, HighGBlock, BiasFilterReport, HealthReceived)
TimedOutput = (
    ImuBlock | MagSample | HighGBlock | BiasFilterReport | HealthReceived
)  # logged at the time of measurement


class SamplePublisher:
    """Gives the samples and reports of one node their host times, and logs them.

    They are held for up to 5 s after a start until the node has answered some clock requests in time, so that
    the first samples do not get host times that would have to be corrected.

    Parameters
    ----------
    name
        Name of the node.
    clock
        Clock of the node.
    order
        Log times, shared by all nodes.
    """

    def __init__(self, name: str, clock: ClockSync, sink: Sink, order: LogTimeSequence) -> None:
        self.newest_block: ImuBlock | None = None
        self.power_on_ns: int | None = None
        """Host time at which the node was switched on; None before its first samples."""
        self.notices: list[Event] = []
        """Events for the user; removed once shown."""
        self._reported_lag_ns = _MIN_REPORTED_LAG_NS
        self.start_event: Event | None = None
        """Event about the newest start of the node, logged with its first samples."""
        self._name, self._clock, self._sink, self._order = name, clock, sink, order
        self._span_ns: list[int] = []  # first and newest published sample time
        self._unlogged_boot: Hello | None = None  # Hello of a boot of which no sample was published yet
        self._imu_times = SlewedTimes(clock)
        self._report_times = {kind: SlewedTimes(clock) for kind in _REPORTS}
        self._supply_history = SupplyHistory()
        self._held: list[TimedOutput] = []
        self._held_since_ns = 0
        self._clock_is_known = False
        self._rate_window = RateWindow()

    @property
    def clock_is_known(self) -> bool:
        """True if samples need not be held any more."""
        if not self._clock_is_known and self._clock.exchanges >= _MIN_CLOCK_REPLIES:
            self._clock_is_known = self._clock.estimate().sigma_ns <= _MAX_INITIAL_SIGMA_NS
        return self._clock_is_known

    def rate(self, now_ns: int) -> float:
        """Return the sample rate over the last two seconds, Hz."""
        return self._rate_window.rate(now_ns)

    def mean_rate(self, samples: int) -> float | None:
        """Return the mean rate, Hz, by sample times; None before two samples. samples: lost ones included."""
        if not self._span_ns or self._span_ns[1] <= self._span_ns[0]:
            return None
        return (samples - 1) / ((self._span_ns[1] - self._span_ns[0]) / NS_PER_S)

    def start_boot(self, hello: Hello) -> None:
        """Note a new boot, whose start is logged with its first samples."""
        self._unlogged_boot = hello

    def restart(self) -> Iterator[NodeSamples]:
        """Publish what is held of the boot that has ended; those of the next one are held again."""
        yield from self.release()
        self._held_since_ns = 0
        self._clock_is_known = False
        self._reported_lag_ns = _MIN_REPORTED_LAG_NS

    def add(self, item: TimedOutput) -> Iterator[NodeSamples]:
        """Publish an item and all held ones if the clock is known or the wait is over, else hold it."""
        if self.clock_is_known or self._hold_expired(item.received_ns):
            yield from self.release()
            yield from self._publish(item)
            return
        if not self._held_since_ns:
            self._held_since_ns = item.received_ns
        self._held.append(item)

    def add_run(self, run: ImuRun) -> bool:
        """Log a run and return True if the clock is known and no samples are held; else return False."""
        if not self.clock_is_known or self._held or self._unlogged_boot is not None:
            return False
        t_ns = self._imu_times.to_host_ns(run.device_ns)
        self._report_lag(int(t_ns[0]))
        t_log_ns = self._order.next_times(run.received_ns)
        self._sink.write_record(replace(run, t_ns=t_ns, t_log_ns=t_log_ns))
        self._extend_span(int(t_ns[0]), int(t_ns[-1]))
        return True

    def release(self) -> Iterator[NodeSamples]:
        """Publish everything that is held."""
        held, self._held = self._held, []
        for item in held:
            yield from self._publish(item)

    def release_expired(self, now_ns: int) -> Iterator[NodeSamples]:
        """Publish everything that is held if the wait for the clock is over."""
        if self._held and self._hold_expired(now_ns):
            yield from self.release()

    def _hold_expired(self, now_ns: int) -> bool:
        return bool(self._held_since_ns) and now_ns - self._held_since_ns > _MAX_CLOCK_WAIT_NS

    def _publish(self, item: TimedOutput) -> Iterator[NodeSamples]:
        if not isinstance(item, ImuBlock):
            record = self._log_report(item)
            if isinstance(record, HighGSamples):
                yield record
            return
        t_ns = self._imu_times.to_host_ns(item.device_ns)
        self._report_lag(int(t_ns[0]))
        if (boot := self._unlogged_boot) is not None:
            self._log_start(boot, int(t_ns[0]))
            self._unlogged_boot = None
        supply = self._supply_history.voltage_at(int(t_ns[0]))
        block = replace(
            item,
            t_ns=t_ns,
            t_log_ns=self._order.next_time(item.received_ns),
            power_on_ns=self.power_on_ns,
            supply=supply,
        )
        self._sink.write_record(block)
        self._extend_span(int(t_ns[0]), int(t_ns[-1]))
        self._rate_window.add(item.received_ns, len(t_ns))
        self.newest_block = block
        yield block

    def _report_lag(self, t_ns: int) -> None:
        """Log samples that were dated too late, and again if the lag turns out to be twice as long."""
        lag_ns = self._imu_times.overlap_ns
        if lag_ns > self._reported_lag_ns:
            self._reported_lag_ns = 2 * lag_ns
            event = lag_event(self._name, lag_ns, lag_ns * OVERLAP_SLEW_RATIO, t_ns)
            self.notices.append(event)
            self._sink.write_record(EventRecord(event))

    def _extend_span(self, first_ns: int, last_ns: int) -> None:
        self._span_ns = [self._span_ns[0] if self._span_ns else first_ns, last_ns]

    def _log_report(self, report: MagSample | HighGBlock | BiasFilterReport | HealthReceived) -> LogRecord:
        """Log a report and return its record.

        A report without samples and clock replies before it is dated by its arrival.
        """
        device_ns = np.array(report.device_ns, np.int64).reshape(-1)
        if self._clock.source == "none":
            self._clock.add_arrival(int(device_ns[-1]) // 1000, report.received_ns)
        times, log_ns = self._report_times[type(report)], report.received_ns
        t_ns = times.to_host_ns(device_ns)
        match report:
            case MagSample():
                record: LogRecord = MagneticField(self._name, t_ns, log_ns, [report.field])
            case HighGBlock():
                # In the order in which the odometry processes the samples.
                record = HighGSamples(self._name, t_ns, self._order.next_time(log_ns), report.accel)
            case BiasFilterReport():
                record = BiasFilterRow(self._name, t_ns, log_ns, filter_report_columns(report))
            case HealthReceived():
                volts, charge = read_supply(report.health)
                record = Battery(self._name, t_ns, log_ns, volts, charge)
                self._supply_history.add(int(t_ns[0]), volts)
        self._sink.write_record(record)
        return record

    def _log_start(self, hello: Hello, t_ns: int) -> None:
        """Log the power-on time of the node; a restart without loss of power does not change it."""
        if self.power_on_ns is None or hello.reset_cause in (ResetCause.POWER_ON, ResetCause.BROWN_OUT):
            self.power_on_ns = int(self._clock.to_host_ns(np.zeros(1, np.int64))[0])
        self.start_event = power_on_event(self._name, hello.boot_id, self.power_on_ns, t_ns)
        self._sink.write_record(EventRecord(self.start_event))
