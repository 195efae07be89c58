"""The document of a walk."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from pupper_analysis.tools.walk.document import _max_over_runs


def test_motor_table_contains_the_largest_value_of_all_runs_per_motor() -> None:
    runs = [SimpleNamespace(torque_peak=np.array(peak)) for peak in ([1.0, 5.0], [3.0, 2.0])]
    walk: Any = SimpleNamespace(gaits=runs)
    np.testing.assert_array_equal(_max_over_runs(walk, "torque_peak"), [3.0, 5.0])
