"""Methods of a log in memory that analyse one channel of a sensor: noise, warm-up and filters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hubodo.errors import InputError
from hubodo.recording import NODE_COLUMNS

# The rest is imported by the methods that need it: importing everything takes four times as long.
if TYPE_CHECKING:
    from pathlib import Path

    from hubodo.recording import Recording
    from hubodo.sensors.allan.result import AllanResult
    from hubodo.sensors.filters.result import FilterComparison
    from hubodo.sensors.standstill_channel import StandstillRecord
    from hubodo.sensors.warmup.forecast import StatedForm
    from hubodo.sensors.warmup.result import WarmupResult


class ChannelMethods:
    """The analyses of one channel of a node."""

    path: Path
    recording: Recording

    def allan(
        self,
        node: str | None = None,
        channel: str = "gz",
        *,
        start: float | None = None,
        end: float | None = None,
        per_octave: int = 1,
        turn: float = 2.0,
        as_is: bool = False,
        trust_units: bool = False,
    ) -> AllanResult:
        """Compute the Allan deviation and noise terms of a stationary sensor, as `hubodo allan` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        channel : str
            `gx` to `gz` or `ax` to `az`.
        start, end : float, optional
            Span of the log to use, s.
        per_octave : int
            Averaging times per octave.
        turn : float
            Time a turntable takes between stops, s, for the advice on maytagging.
        as_is : bool
            Use every sample, also disturbed ones, as allantools does.
        trust_units : bool
            Do not check the unit by the magnitude.

        Returns
        -------
        AllanResult
            Allan deviation with sigma, and the fitted noise terms.

        Raises
        ------
        InputError
            If there is no such node or channel, the sensor moved, or unit or duration do not suit.

        References
        ----------
        IEEE Std 952-1997, annex C (noise terms from the Allan variance).

        Examples
        --------
        >>> import hubodo
        >>> allan = hubodo.open("night.mcap").allan("left", "gz")
        >>> f"{allan.terms['N'].value:.1e} rad/√s"
        '1.4e-04 rad/√s'
        """
        from hubodo.sensors.allan.characterise import characterise_standstill_noise

        standstill = self._standstill(
            node,
            channel,
            start=start,
            end=end,
            trust_units=trust_units,
            trust_still=as_is,
            cut_disturbances=True,
        )
        return characterise_standstill_noise(
            standstill, turn=turn, per_octave=per_octave, keep_all_samples=as_is
        )

    def warmup(
        self,
        node: str | None = None,
        channel: str = "gz",
        *,
        age: float = 0.0,
        form: StatedForm | None = None,
        start: float | None = None,
        end: float | None = None,
        trust_units: bool = False,
    ) -> WarmupResult:
        """Model the bias of a gyro axis after power-on, as `hubodo warmup` does.

        The model is b(t) = C1 (1 - exp(-t/T)) + C2 with the time t since power-on, or an extension of it if
        its residual is not white.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        channel : str
            `gx`, `gy` or `gz`.
        age : float
            Time since power-on at the first sample, s.
        form : {"exponential", "two exponentials"}, optional
            Stated form of the warm-up, which is believed; by default the forecast averages all forms.
        start, end : float, optional
            Span of the log to use, s.
        trust_units : bool
            Do not check the unit by the magnitude.

        Returns
        -------
        WarmupResult
            The accepted model with sigmas, its whiteness tests, and forecasts.

        Raises
        ------
        InputError
            If there is no such node or axis, the sensor moved, or unit or duration do not suit.
        """
        from hubodo.sensors.warmup.characterise import characterise_standstill_warmup

        _check_gyro_channel(channel)
        standstill = self._standstill(node, channel, start=start, end=end, trust_units=trust_units)
        return characterise_standstill_warmup(standstill, age=age, form=form)

    def filters(
        self,
        node: str | None = None,
        channel: str = "gz",
        *,
        reference: str | None = None,
        standstills: Sequence[tuple[float, float]] = (),
        start: float | None = None,
        end: float | None = None,
    ) -> FilterComparison:
        """Compare filters of a gyro axis, as `hubodo filters` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        channel : str
            `gx`, `gy` or `gz`.
        reference : str, optional
            Table, or table and column, with the true rate, angle or wheel speed: `wheels`, `table`,
            `frame.gz`. By default filters are judged by the prediction of the next sample.
        standstills : sequence of (float, float)
            Start and end of each standstill, s; by default detected.
        start, end : float, optional
            Span of the log to use, s.

        Returns
        -------
        FilterComparison
            Errors, delays and run times of all filters, and the settings of the best one for the node.

        Raises
        ------
        InputError
            If there is no such node, axis or reference, or the samples do not suffice.

        References
        ----------
        Shah et al., Ground vehicle odometry using a non-intrusive inertial speed sensor, eq. 1-14.
        Barshan, Durrant-Whyte, Evaluation of a solid-state gyroscope for robotics applications, eq. 7-12.
        """
        from hubodo.sensors.filters.compare import compare_filters

        _check_gyro_channel(channel)
        name = self._node(node)
        try:
            return compare_filters(
                self.recording,
                name,
                channel,
                reference=reference,
                standstills=standstills,
                start=start,
                end=end,
            )
        except InputError as error:
            raise InputError(f"{self.path}, node {name}: {error}") from None

    def _standstill(self, node: str | None, channel: str, **options: Any) -> StandstillRecord:
        """Return one checked channel of a stationary node; options as in `read_standstill_channel`."""
        from hubodo.sensors.standstill_channel import read_standstill_channel

        return read_standstill_channel(
            self.recording, self._node(node), channel, log=str(self.path), **options
        )

    def _node(self, name: str | None) -> str:
        """Return the named node, or the only one; raise InputError if there is none."""
        nodes = tuple(self.recording.nodes)
        if name is None and len(nodes) == 1:
            return nodes[0]
        if name is None or name not in nodes:
            problem = "which node?" if name is None else f"no node {name!r}"
            raise InputError(f"{self.path}: {problem} It has {', '.join(nodes) or 'none'}")
        return name


def _check_gyro_channel(channel: str) -> None:
    """Raise InputError unless the channel is a gyro axis."""
    if channel not in NODE_COLUMNS[1:4]:
        raise InputError(f"channel {channel!r}: choose from {', '.join(NODE_COLUMNS[1:4])}")
