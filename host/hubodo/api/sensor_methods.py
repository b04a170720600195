"""Methods of a log in memory that analyse one sensor: heading, IMU calibration, north, and its channels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from hubodo.api.channel_methods import ChannelMethods

# The rest is imported by the methods that need it: importing everything takes four times as long.
if TYPE_CHECKING:
    from hubodo.api.arguments import StrPath
    from hubodo.calibration.file import Calibration
    from hubodo.sensors.heading.result import HeadingResult
    from hubodo.sensors.imu.result import ImuCalibration
    from hubodo.sensors.imu.scalar_calibration import Convention
    from hubodo.sensors.north.measurements import Method as NorthMethod
    from hubodo.sensors.north.result import NorthResult
    from hubodo.sensors.rate_table.result import RateCalibration


class SensorMethods(ChannelMethods):
    """The sensor analyses of a log, each for one node of it."""

    def heading(
        self,
        node: str | None = None,
        axis: Literal["x", "y", "z"] = "z",
        *,
        calibration: StrPath | Calibration | None = None,
        allan: StrPath | None = None,
        age: float | None = None,
        standstills: Sequence[tuple[float, float]] = (),
        scale_sigma: float | None = None,
        lag: float | None = None,
        step: float = 0.1,
    ) -> HeadingResult:
        """Estimate the heading from one vertical gyro axis, as `hubodo heading` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        axis : {"x", "y", "z"}
            Vertical axis.
        calibration : str, path-like or Calibration, optional
            Warm-up and scale of the node.
        allan : str or path-like, optional
            Noise of the axis: output of `hubodo allan --json`.
        age : float, optional
            Time since power-on at the first sample, s.
        standstills : sequence of (float, float)
            Start and end of each standstill, s; by default detected.
        scale_sigma : float, optional
            Relative 1σ of the scale; by default from the calibration, else 0.01.
        lag : float, optional
            Delay of the gyro, s; by default from the calibration, else 0.005.
        step : float
            Time step of the result, s.

        Returns
        -------
        HeadingResult
            Heading over time with sigma, and its score if the log holds a true heading.

        Raises
        ------
        InputError
            If the axis is missing or not vertical, or neither standstill nor calibration gives the bias.

        References
        ----------
        Barshan, Durrant-Whyte, Evaluation of a solid-state gyroscope for robotics applications.
        """
        from hubodo.api.sensors import estimate_log_heading

        return estimate_log_heading(
            self, self._node(node), axis, calibration, allan, age, standstills, scale_sigma, lag, step
        )

    def calibrate_imu(
        self,
        node: str | None = None,
        *,
        gravity: float = 9.80665,
        latitude_deg: float | None = None,
        table_rate_deg_s: float | None = None,
        convention: Convention = "symmetric",
        min_standstill: float = 1.0,
        temperature_order: int | None = None,
    ) -> ImuCalibration:
        """Calibrate accelerometer and gyro from nine or more static poses, as `hubodo calibrate imu` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        gravity : float
            Local gravity, m/s².
        latitude_deg : float, optional
            Latitude; makes Earth rate the reference of precise gyros.
        table_rate_deg_s : float, optional
            Constant rate of a rate table, as the reference of the gyro.
        convention : {"symmetric", "x-first"}
            Accelerometer frame: symmetric cross-axis matrix, or x axis along sensor x.
        min_standstill : float
            Shortest standstill that counts as a pose, s.
        temperature_order : int, optional
            Order of the polynomials by which the biases follow the temperature, 0 for none; by default as
            held-out poses decide.

        Returns
        -------
        ImuCalibration
            Bias, scale and cross-axis terms of both triads with sigmas.

        Raises
        ------
        InputError
            If there is no such node, or its units are doubtful.
        CalibrationError
            If the poses do not suffice, or held-out poses become worse.

        References
        ----------
        Avrutov, scalar calibration of accelerometers and gyros, eq. 5.
        """
        from hubodo.sensors.imu.node_imu import ImuOptions, calibrate_node_imu

        name = self._node(node)
        options = ImuOptions(
            gravity, latitude_deg, table_rate_deg_s, convention, min_standstill, temperature_order
        )
        return calibrate_node_imu(self.recording.nodes[name], name, str(self.path), options)

    def calibrate_rate(
        self,
        node: str | None = None,
        axis: Literal["x", "y", "z"] = "z",
        *,
        rates_deg_s: Sequence[float] = (),
        table: StrPath | None = None,
        settle: float = 1.0,
        min_plateau: float = 3.0,
        full_scale_deg_s: float | None = None,
        latitude_deg: float | None = None,
    ) -> RateCalibration:
        """Calibrate one gyro axis on a rate table, as `hubodo calibrate rate` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        axis : {"x", "y", "z"}
            Gyro axis along that of the table.
        rates_deg_s : sequence of float
            Rates in order without their times, deg/s.
        table : str or path-like, optional
            In place of `rates_deg_s`: CSV file with the rates over time, columns `t` and `rate_deg_s`.
        settle : float
            Time cut off at both ends of each rate, s.
        min_plateau : float
            Shortest steady rate that counts with `rates_deg_s`, s.
        full_scale_deg_s : float, optional
            Full scale of the gyro; by default the largest rate.
        latitude_deg : float, optional
            Latitude of a table with a vertical axis; takes Earth rate off the bias.

        Returns
        -------
        RateCalibration
            Bias, scale error, asymmetry, nonlinearity and hysteresis with sigmas.

        Raises
        ------
        InputError
            If there is no such node, its units are doubtful, or the axis does not follow the table.
        CalibrationError
            If the rates do not suffice.

        References
        ----------
        IEEE Std 952-2020, scale factor tests on a rate table.
        """
        from hubodo.api.sensors import calibrate_log_rate

        return calibrate_log_rate(
            self,
            self._node(node),
            axis,
            rates_deg_s,
            table,
            settle,
            min_plateau,
            full_scale_deg_s,
            latitude_deg,
        )

    def north(
        self,
        node: str | None = None,
        axis: Literal["x", "y", "z"] = "x",
        *,
        latitude_deg: float,
        method: NorthMethod = "maytag",
        near_deg: float | None = None,
        calibration: StrPath | Calibration | None = None,
        allan: StrPath | None = None,
        settle: float | None = None,
        find_stops: bool = False,
        scale_sigma: float | None = None,
    ) -> NorthResult:
        """Find the azimuth of a turntable's zero from Earth rate, as `hubodo north` does.

        Parameters
        ----------
        node : str, optional
            Name of the node; by default the only one.
        axis : {"x", "y", "z"}
            Gyro axis, level on the table.
        latitude_deg : float
            Latitude, degrees, north positive.
        method : {"maytag", "maytag4", "carousel", "east"}
            How the table was moved.
        near_deg : float, optional
            Approximate azimuth of table zero, degrees, to resolve an ambiguity.
        calibration : str, path-like or Calibration, optional
            Calibration to apply.
        allan : str or path-like, optional
            Noise of the axis: output of `hubodo allan --json`.
        settle : float, optional
            Time cut off at both ends of each stop, s; by default detected.
        find_stops : bool
            Detect the stops even if the log has a table.
        scale_sigma : float, optional
            Relative 1σ of the scale; by default from the calibration, else 0.01.

        Returns
        -------
        NorthResult
            Azimuth of table zero, clockwise from north, with its sigma, rad.

        Raises
        ------
        InputError
            If the axis is missing or not level, units are doubtful, or the stops do not suffice.

        References
        ----------
        Prikhodko et al., What is MEMS gyrocompassing? Comparative analysis of maytagging and carouseling.
        """
        from hubodo.api.sensors import find_log_north

        return find_log_north(
            self,
            self._node(node),
            axis,
            latitude_deg=latitude_deg,
            method=method,
            near_deg=near_deg,
            calibration=calibration,
            allan=allan,
            settle=settle,
            find_stops=find_stops,
            scale_sigma=scale_sigma,
        )
