"""Assertions of the checks of faults are to be explained as those of tests are."""

import pytest

pytest.register_assert_rewrite(
    "fault_case", "fault_checks", "friction_checks", "motor_checks", "sensor_fault_checks", "valve_checks"
)
