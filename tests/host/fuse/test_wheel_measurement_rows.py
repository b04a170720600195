"""Layout of the rows of all wheels in one Jacobian, against a Jacobian filled entry by entry."""

import numpy as np
import pytest

from hubodo.fuse.wheel.entries import StateLayout
from hubodo.fuse.wheel.measurement_rows import MeasurementRows
from hubodo.fuse.wheel.measurements import BETWEEN_WHEELS, MEASUREMENTS, PER_WHEEL


@pytest.mark.parametrize("wheels", [1, 2])
@pytest.mark.parametrize("position_aided", [False, True])
def test_each_derivative_residual_and_variance_is_in_the_row_of_its_measurement_and_wheel(
    wheels: int, position_aided: bool
) -> None:
    layout = StateLayout(wheels, position_aided)
    rows, rng = MeasurementRows(layout), np.random.default_rng(7)
    jacobian = np.zeros((wheels * len(MEASUREMENTS), layout.size))
    residuals, variances = (rng.standard_normal(len(jacobian)) for _ in range(2))
    values: list[float] = []
    for wheel in range(wheels):
        of_wheel = [rows.row_of(measurement, wheel) for measurement in MEASUREMENTS]
        for row, measurement in zip(of_wheel, MEASUREMENTS, strict=True):
            for entry in measurement.STATES:
                jacobian[row, layout.wheels[wheel][entry]] = rng.standard_normal()
                values.append(jacobian[row, layout.wheels[wheel][entry]])
        values += [*residuals[of_wheel], *variances[of_wheel]]
    h, z, r = rows.fill(values)
    assert np.array_equal(h, jacobian)
    assert np.array_equal(z, residuals) and np.array_equal(r, variances)


def test_rows_that_compare_wheels_come_after_those_of_all_single_wheels() -> None:
    """They are whitened given all others."""
    rows = MeasurementRows(StateLayout(2))
    single = [rows.row_of(measurement, wheel) for measurement in PER_WHEEL for wheel in range(2)]
    between = [rows.row_of(measurement, wheel) for measurement in BETWEEN_WHEELS for wheel in range(2)]
    assert max(single) < min(between)
    assert sorted(single + between) == list(range(rows.count))
    assert sorted(rows.rows_of_wheel(0) + rows.rows_of_wheel(1)) == list(range(rows.count))
