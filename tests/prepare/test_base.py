"""Frame of a base that the preparation frees."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from pupper_analysis.prepare.base import place_base_frame


@pytest.mark.parametrize("keyframe", ["", '<key name="home" qpos="0 0 0 0 1.5 0 0.1 0"/>'])
def test_keyframe_of_a_fixed_base_has_no_tilt_of_the_base(keyframe: str) -> None:
    """Reference: the base of the file is level. As a quaternion, the joint angles turn it over."""
    limb = '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>'
    limbs = "".join(
        f'<body pos="{number / 10} 0 0"><joint name="j{number}" axis="0 1 0"/>{limb}</body>'
        for number in range(8)
    )
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="trunk" pos="0 0 0.5"><geom size="0.1"/>'
        f"{limbs}</body></worldbody><keyframe>{keyframe}</keyframe></mujoco>"
    )
    file = spec.compile()
    spec.body("trunk").add_freejoint()
    assert place_base_frame(spec, file, Path("robot.xml")) == []
