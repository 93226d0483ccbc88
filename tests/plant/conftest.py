"""Assertions of the checks in `fault_checks` are to be explained as those of tests are."""

import pytest

pytest.register_assert_rewrite("fault_checks")
