"""Commands agree with each other on a variant, on random robots, and on an arm."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import agreement, arm_features
from tests.support.every_command import share_robots
from tests.support.shared_rollouts import share_rollouts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "objectives"),
    [(None, ("utilisation", "margin")), (910, ("margin",)), (903, ("utilisation",))],
)
def test_commands_agree_on_the_same_robot(
    seed: int | None, objectives: tuple[str, ...], tmp_path: Path
) -> None:
    """Robots: a variant, a random pair of files, and a random URDF alone, which is converted as
    well.
    """
    name, files = "v3", ("v3",)
    if seed is not None:
        [(name, files)] = agreement.write_random_robots(seed, 1, tmp_path)
    place = tmp_path / "answers"
    place.mkdir()
    with share_robots(), share_rollouts():
        found = agreement.compare_commands(
            name, place, *files, everywhere=seed is None, objectives=objectives
        )
    assert not found.disagreements, found.codes
    stood = found.codes["stand"]
    assert not stood.startswith("exit"), stood  # a robot that is refused proves nothing
    assert ("converted, 8deg" in found.codes) is (len(files) == 1 and seed is not None)


@pytest.mark.slow
def test_payload_of_the_best_stance_equals_that_of_the_command_payload(tmp_path: Path) -> None:
    """On the variant whose search is shortest."""
    found = agreement.Agreement("original")
    with share_robots(), share_rollouts():
        run = agreement.Commands(tmp_path, ("original",))
        agreement.compare_best(found, run, ("payload",))
    assert found.codes.keys() == {"best payload", "payload of the best"}
    assert not found.disagreements, found.codes


@pytest.mark.slow
def test_commands_agree_on_the_payload_of_an_arm(tmp_path: Path) -> None:
    urdf, mjcf = arm_features.files(tmp_path, arm_features.FEATURES["as it is"])
    place = tmp_path / "answers"
    place.mkdir()
    found = agreement.compare_commands("arm", place, str(urdf), str(mjcf))
    assert not found.disagreements, found.codes
    assert found.payload > 0
