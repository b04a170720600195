"""The filters of Shah et al., in float.

The paper is "Ground vehicle odometry using a non-intrusive inertial speed sensor".

`pseudo_measurement`: bias of three axes from the known magnitude of the rate (eq. 1-3).
`rate_bias_kalman`: rate and bias of one axis with constant gains (eq. 4-12); firmware/bias_filter.py is the
same in integers.
`recursive_least_squares`: rate of one axis by least squares that forget (eq. 13-14).

Each is a live object, `update(sample)` in plain floats, whose `run(samples)` takes a whole recording and
goes on from there. Samples must be finite: `run` raises ValueError for others, `update` does not look.
"""
