"""Assertions of the checks of faults are to be explained as those of tests are."""

import pytest

pytest.register_assert_rewrite("fault_case", "fault_checks", "drive_and_seal_checks")
