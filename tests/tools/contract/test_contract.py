"""Contracts between trainer, deployment and model: equal values give no finding, and planted
mistakes are found with both lines.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.present.document import FileFinding, NextStep, Number, Table, get_english, word
from pupper_analysis.robot.compare.compare import compare_files
from pupper_analysis.tools.contract import Contract, read_contract
from pupper_analysis.tools.contract.document import contract_document
from pupper_analysis.tools.contract.findings import DefaultPoseStand
from pupper_analysis.tools.contract.orders import is_mirror_image
from tests.tools.contract.sources import (
    ANGLES,
    JOINTS,
    MJCF,
    ONNX,
    UNITREE_GYM,
    URDF,
    field,
    format_list,
    onnx,
    value,
    write_all,
)

OTHERS = ("deploy.yaml", "config.yaml", "policy.json", "policy.onnx")


@pytest.fixture
def sources(tmp_path: Path) -> dict[str, Path]:
    return write_all(tmp_path)


def contract(*paths: str | Path) -> Contract:
    return read_contract(URDF, *paths, stand=False)


def write_policy(path: Path, inputs: int, outputs: int, metadata: dict[str, str]) -> Path:
    graph = field(11, value("obs", 0, inputs)) + field(12, value("actions", 0, outputs))
    path.write_bytes(field(7, graph) + onnx(**metadata))
    return path


@pytest.mark.parametrize(
    ("inputs", "outputs", "metadata", "kind", "values", "severity"),
    [
        (27, 14, ONNX, "actions", (12.0, 14.0), "error"),
        (25, 10, ONNX, "actions", (12.0, 10.0), "warning"),
        (45, 14, {}, "actions", (12.0, 14.0), "error"),
        (45, 10, {}, "", (), ""),
        (27, 12, ONNX, "", (), ""),
        (81, 12, ONNX, "", (), ""),
        (30, 12, ONNX, "observed numbers", (27.0, 30.0), "error"),
        (27, 12, {**ONNX, "observation_names": "joint_pos,actions,command"}, "", (), ""),
        (
            *(24, 12, {**ONNX, "observation_names": "joint_pos,actions,command"}),
            *("observed numbers", (24.0, 24.0), "error"),
        ),
    ],
)
def test_network_of_another_size_than_joints_or_observations_is_reported(
    tmp_path: Path,
    inputs: int,
    outputs: int,
    metadata: dict[str, str],
    kind: str,
    values: tuple[float, ...],
    severity: str,
) -> None:
    """References: 12 joints; angular velocity (3), joint positions (12) and last actions (12)."""
    path = write_policy(tmp_path / "policy.onnx", inputs, outputs, metadata)
    found = [finding for finding in contract(path).findings if finding.kind != "kd"]
    assert [(finding.kind, finding.values, finding.severity) for finding in found] == (
        [(kind, values, severity)] if kind else []
    )
    for finding in found:
        assert {str(int(number)) for number in values} <= set(re.findall(r"\d+", finding.message))
        assert str(inputs if kind == "observed numbers" else outputs) in finding.diagnostic.short


@pytest.mark.parametrize(
    ("inputs", "outputs", "actions"),
    [
        (27, {"sigma": 1, "value": 1, "mu": 12}, [12.0]),  # rl_games
        (27, {"sigma": 1, "value": 1, "mu": 10}, [10.0]),
        (0, {"actions": 0}, []),
    ],
)
def test_action_of_several_outputs_is_counted_and_a_symbolic_size_is_unknown(
    tmp_path: Path, inputs: int, outputs: dict[str, int], actions: list[float]
) -> None:
    """Reference: 12 joints, and the size of ``mu``, the mean of the actions."""
    path = tmp_path / "policy.onnx"
    graph = field(11, value("obs", 0, inputs))
    graph += b"".join(field(12, value(name, 0, size)) for name, size in outputs.items())
    path.write_bytes(field(7, graph) + onnx(**ONNX))
    read = contract(path)
    assert [fact.value for fact in read.facts if fact.quantity == "actions"] == actions
    assert [fact.value for fact in read.facts if fact.quantity == "observed numbers"] == (
        [float(inputs)] if inputs else []
    )
    found = [finding.kind for finding in read.findings if finding.kind != "kd"]
    assert found == (["actions"] if actions == [10.0] else [])


@pytest.mark.parametrize(
    ("inputs", "outputs", "observed"),
    [
        ({"obs": 30, "h_in": 64}, {"actions": 12, "h_out": 64}, [30.0]),  # with a state
        ({"proprioception": 30, "scan": 17}, {"actions": 12}, []),
    ],
)
def test_observed_numbers_of_several_inputs_are_counted_only_beside_states(
    tmp_path: Path, inputs: dict[str, int], outputs: dict[str, int], observed: list[float]
) -> None:
    """The first of several inputs without states is a part of the observation."""
    path = tmp_path / "policy.onnx"
    graph = b"".join(field(11, value(name, 0, size)) for name, size in inputs.items())
    graph += b"".join(field(12, value(name, 0, size)) for name, size in outputs.items())
    path.write_bytes(field(7, graph) + onnx(**ONNX))
    facts = contract(path).facts
    assert [fact.value for fact in facts if fact.quantity == "observed numbers"] == observed
    assert [fact.value for fact in facts if fact.quantity == "actions"] == [12.0]


@pytest.mark.parametrize(
    ("angles", "kinds"),
    [([ANGLES[3 * leg + part] for part in range(3) for leg in range(4)], {"_1"}),
     (ANGLES, {"_1", "_2", "_3"})],
)  # fmt: skip
def test_isaac_lab_lists_are_ordered_by_depth_if_left_and_right_agree(
    sources: dict[str, Path], angles: list[float], kinds: set[str]
) -> None:
    """As in policies of Isaac Lab; a list without left-right symmetry in any order is not read."""
    path = sources["policy.json"]
    text = path.read_text()
    path.write_text(text.replace(format_list(ANGLES), format_list(angles)))
    found = contract(sources["isaac_cfg.py"], path)
    (read,) = [source for source in found.sources if source.role == "policy"]
    assert {name[-2:] for name in read.order[:4]} == kinds
    assert found.findings == ()
    path.write_text(text.replace(format_list(ANGLES), format_list(range(12))))
    found = contract(sources["isaac_cfg.py"], path)
    assert not [
        fact for fact in found.facts if fact.source == path.name and "angle" in fact.quantity
    ]
    assert any(note.code == "contract-list-unread" for note in found.unread)


def test_motor_table_maps_joints_in_any_order(sources: dict[str, Path]) -> None:
    """As in rl_sar: the table of the robot names the motors, and the policy refers to their
    numbers."""
    folder = sources["deploy.yaml"].parent / "more"
    folder.mkdir()
    base, policy = folder / "base.yaml", folder / "config.yaml"
    motors = [*JOINTS[3:6], *JOINTS[:3], *JOINTS[6:]]
    base.write_text(
        f"pupper:\n  joint_names: {format_list(motors)}\n"
        f"  joint_mapping: {format_list(range(12))}\n"
        f"  fixed_kp: {format_list([80] * 12)}\n  default_dof_pos: {format_list([0.0] * 12)}\n"
    )
    numbers = [3, 4, 5, 0, 1, 2, *range(6, 12)]
    policy.write_text(
        f"pupper/walk:\n  JOINT_MAPPING: {format_list(numbers)}\n"
        f"  rl_kp: {format_list([5.0] * 12)}\n"
        f"  default_dof_pos: {format_list(ANGLES)}\n"
    )
    found = contract(sources["gym_cfg.py"], base, policy)
    assert found.findings == ()
    order = {source.name: (source.order_source, source.order) for source in found.sources}
    assert order["config.yaml:pupper/walk"] == ("motors", tuple(JOINTS))
    policy.write_text(policy.read_text().replace(format_list(numbers), format_list(range(12))))
    wrong = contract(sources["gym_cfg.py"], base, policy).findings
    assert {finding.kind for finding in wrong} == {"default angle"}
    moved = {joint for finding in wrong for joint in finding.joints}
    assert moved == set(JOINTS[:6]) - {JOINTS[1], JOINTS[4]}


@pytest.mark.parametrize("given", [".inf", "-1", "0.5", "0", "x"])
def test_invalid_motor_numbers_make_the_contract_incomplete(
    sources: dict[str, Path], given: str
) -> None:
    path = sources["deploy.yaml"]
    text = path.read_text()
    numbers = format_list(range(12))
    assert numbers in text
    path.write_text(text.replace(numbers, format_list([*range(11), given])))
    found = contract(path)
    assert "contract-motors-unread" in [message.code for message in found.unread]
    assert not found.passed


def test_names_are_matched_without_a_common_prefix_and_by_a_mapping(
    sources: dict[str, Path],
) -> None:
    """Reference: the twelve joints; names without relation to them need a mapping."""
    path = sources["config.yaml"]
    text = path.read_text()
    path.write_text(text.replace("leg_", "robot_leg_"))
    assert contract(sources["gym_cfg.py"], path).findings == ()
    other = [f"motor{number}" for number in range(12)]
    path.write_text(text.replace(format_list(JOINTS), format_list(other)))
    with pytest.raises(ModelError, match="init_kps is not read"):
        contract(path)
    names = dict(zip(other, JOINTS, strict=True))
    found = read_contract(URDF, path, names=names, stand=False)
    assert len([fact for fact in found.facts if fact.quantity == "kp"]) == 12


def test_number_of_network_actions_is_compared_with_other_sources(
    sources: dict[str, Path],
) -> None:
    network = sources["policy.onnx"].with_name("bare.onnx")
    graph = field(12, value("actions", 0, 12)) + field(11, value("obs", 0, 36))
    network.write_bytes(field(7, graph))
    gym = sources["gym_cfg.py"]
    gym.write_text(gym.read_text() + "    class env:\n        num_actions = 12\n")
    found = contract(gym, network)
    assert found.findings == ()
    stated = {fact.quantity: fact.value for fact in found.facts if fact.source == network.name}
    assert stated == {"actions": 12, "observed numbers": 36}
    gym.write_text(gym.read_text().replace("num_actions = 12", "num_actions = 10"))
    (finding,) = contract(gym, network).findings
    assert (finding.kind, finding.values) == ("actions", (10, 12))


@pytest.mark.parametrize(("actions", "kinds"), [(12, set()), (0, {"observed numbers"})])
def test_inputs_are_compared_with_an_observation_without_elements(
    tmp_path: Path, actions: int, kinds: set[str]
) -> None:
    """With 0 actions, the only term has 0 elements, and a remainder is not defined."""
    deploy = tmp_path / "deploy.yaml"
    deploy.write_text(
        f"kp: 5.0\nnum_actions: {actions}\nnum_obs: 12\nobservations:\n  last_action: {{}}\n"
    )
    assert {finding.kind for finding in contract(deploy).findings} == kinds


def test_joints_of_other_names_are_matched_by_structure(
    tmp_path: Path, sources: dict[str, Path]
) -> None:
    """The URDF's joints are named by numbers; sources that use these names are matched as well."""
    urdf, text = tmp_path / "numbered.urdf", URDF.read_text()
    names = {joint: f"m{number}" for number, joint in enumerate(JOINTS)}
    for joint, name in names.items():
        text = text.replace(f'<joint name="{joint}"', f'<joint name="{name}"')
    for number, link in enumerate(re.findall(r'<link name="(leg_[^"]*)"', text)):
        text = text.replace(f'"{link}"', f'"body{number}"')
    urdf.write_text(text)
    deploy = sources["config.yaml"]
    deploy.write_text(deploy.read_text().replace(format_list(JOINTS), format_list(names.values())))
    found = read_contract(MJCF, urdf, deploy, stand=False)
    assert any(note.code == "contract-matched" for note in found.notes)
    stated = {
        (fact.source, fact.joint) for fact in found.facts if fact.quantity in ("effort", "kp")
    }
    assert stated >= {("numbered.urdf", joint) for joint in JOINTS}
    assert stated >= {("config.yaml:walker", joint) for joint in JOINTS}
    assert {finding.kind for finding in found.findings} == {"kd"}  # 0.25 deployed, 0.1 in the MJCF
    (order,) = {source.order for source in found.sources if source.name == "config.yaml:walker"}
    assert order == tuple(JOINTS)
    first = text.index('name="m4"')
    urdf.write_text(text[:first] + text[first:].replace('effort="3', 'effort="2', 1))
    (finding,) = [finding for finding in read_contract(MJCF, urdf, stand=False).findings
                  if finding.kind == "effort" and not finding.probable_mistake]  # fmt: skip
    assert finding.joints == (JOINTS[4],)


def test_usd_is_accepted_as_the_model_of_a_contract(tmp_path: Path) -> None:
    from tests.tools.usd import written

    path = written.write(tmp_path)
    deploy = tmp_path / "deploy.yaml"
    deploy.write_text("joint_names: [hip, knee]\njoint_lower_limits: [-0.523599, -2.09440]\n")
    found = read_contract(path, deploy, stand=False)
    assert found.findings == ()
    stated = {fact.joint: fact for fact in found.facts
              if fact.source == path.name and fact.quantity == "lower limit"}  # fmt: skip
    assert stated["knee"].value == pytest.approx(-2.0943951)
    assert stated["knee"].place.startswith(f"{path}:<")
    deploy.write_text(deploy.read_text().replace("-2.09440", "-2.3"))
    (finding,) = read_contract(path, deploy, stand=False).findings
    assert (finding.kind, finding.joints) == ("lower limit", ("knee",))
    assert finding.places == (f"{deploy}:2", stated["knee"].place)


def test_line_of_a_training_value_is_that_of_its_assignment(sources: dict[str, Path]) -> None:
    """Closed form of the trained scale: 0.5 (2 x 1.5) / 5 + 0.45 = 0.75."""
    text = sources["deploy.yaml"].read_text()
    sources["deploy.yaml"].write_text(
        text.replace(format_list([0.75] * 12), format_list([0.4] * 12))
    )
    found = contract(sources["mjlab_cfg.py"], sources["deploy.yaml"])
    (finding,) = [finding for finding in found.findings if finding.kind == "action scale"]
    place, _, line = finding.places[0].rpartition(":")
    assert "SCALE[name] = " in Path(place).read_text().splitlines()[int(line) - 1]
    assert finding.joints == tuple(JOINTS)
    assert finding.values == (pytest.approx(0.75), 0.4)  # 0.5 * (2 * 1.5) / 5 + 0.45
    assert "joints by 53 % of the trained motion" in finding.message


def test_rounded_numbers_agree(sources: dict[str, Path]) -> None:
    """5.0123 in the trainer agrees with 5.0; 5.1 does not."""
    text = sources["motors.py"].read_text()
    sources["motors.py"].write_text(text.replace("10.0 / 2", "10.0 / 2 + 0.0123"))
    deploy = sources["deploy.yaml"]
    found = contract(sources["mjlab_cfg.py"], deploy)
    assert [finding for finding in found.findings if finding.kind == "kp"] == []  # 5.0123 is 5.0
    deploy.write_text(deploy.read_text().replace(format_list([5.0] * 12), format_list([5.1] * 12)))
    found = contract(sources["mjlab_cfg.py"], deploy)
    assert [finding.joints for finding in found.findings if finding.kind == "kp"] == [tuple(JOINTS)]


def test_left_right_asymmetry_is_found_in_a_single_source(sources: dict[str, Path]) -> None:
    text = sources["isaac_cfg.py"].read_text()
    sources["isaac_cfg.py"].write_text(text.replace('"leg_.*_l_1": -0.26', '"leg_.*_l_1": 0.26'))
    found = contract(sources["isaac_cfg.py"])
    assert {finding.probable_mistake for finding in found.findings} == {"mirror"}
    assert {finding.joints for finding in found.findings} == {
        ("leg_front_r_1", "leg_front_l_1"), ("leg_back_r_1", "leg_back_l_1")}  # fmt: skip
    assert found.findings[0].values == (0.26, 0.26)


def test_asymmetric_model_without_shared_numbers_is_not_a_disagreement(tmp_path: Path) -> None:
    """The policy alone states kp and kd; the only finding is the damping within the model."""
    joints = {"FL_hip_joint": 0.1, "FR_hip_joint": 0.2}
    bodies = "".join(
        f'<body><geom size=".1"/><joint name="{name}" damping="{damping}" '
        'armature=".1" frictionloss=".2"/></body>'
        for name, damping in joints.items()
    )
    model, config = tmp_path / "two.xml", tmp_path / "config.yaml"
    model.write_text(f'<mujoco model="two"><worldbody>{bodies}</worldbody></mujoco>')
    lines = ["robot:", "  joint_names: [FL_hip_joint, FR_hip_joint]"]
    lines += ["  kps: [20.0, 20.0]", "  kds: [1.5, 1.5]"]
    config.write_text("\n".join(lines) + "\n")
    found = read_contract(model, config, stand=False)
    assert [finding.probable_mistake for finding in found.findings] == ["mirror"]
    shown = contract_document(found)
    assert get_english(shown.verdict) == "NOT COMPARED"
    assert get_english(shown.title) == "two.xml and config.yaml"
    first, second, *_ = [getattr(part, "short", "") or part.en for part in shown.findings]
    assert first == "no number in both; 1 left-right warning"
    assert second == "only the .yaml states kp, kd"
    alone = contract_document(read_contract(model, stand=False))
    assert get_english(alone.verdict) == "ASYMMETRIC"
    assert get_english(alone.title) == "two.xml"


def test_symmetric_model_without_shared_numbers_is_not_called_an_agreement(tmp_path: Path) -> None:
    """Nothing differs, because nothing was compared."""
    gains = tmp_path / "gains.yaml"
    gains.write_text(
        "joint_names: [" + ", ".join(JOINTS) + "]\n" + "kps: [5.0" + 11 * ", 5.0" + "]"
    )
    found = read_contract(URDF, gains, stand=False)
    assert not found.passed
    assert found.findings == ()
    shown = contract_document(found)
    assert get_english(shown.verdict) == "NOT COMPARED"
    assert read_contract(URDF, gains, stand=False, fail_on="error").passed


def test_models_that_agree_are_not_called_different_if_left_and_right_differ(
    tmp_path: Path,
) -> None:
    """URDF and MJCF state the same asymmetric damping: no difference between the sources."""
    model, other = tmp_path / "two.xml", tmp_path / "two.urdf"
    joints = {"FL_hip_joint": 0.1, "FR_hip_joint": 0.2}
    bodies = "".join(
        f'<body name="{name}_link"><geom size=".1"/>'
        f'<joint name="{name}" damping="{damping}"/></body>'
        for name, damping in joints.items()
    )
    model.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    inertial = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(
        f'<link name="{name}_link">{inertial}</link><joint name="{name}" type="continuous">'
        f'<parent link="base"/><child link="{name}_link"/><axis xyz="0 0 1"/>'
        f'<dynamics damping="{damping}"/></joint>'
        for name, damping in joints.items()
    )
    other.write_text(f'<robot name="two"><link name="base">{inertial}</link>{links}</robot>')
    found = read_contract(model, other, stand=False)
    shown = contract_document(found)
    assert {finding.probable_mistake for finding in found.findings} == {"mirror"}
    assert get_english(shown.verdict) == "ASYMMETRIC"
    assert shown.findings[0].short == (
        "2 shared numbers agree; 2 left-right differences in 2 sources"
    )
    assert get_english(shown.findings[1]) == "compared: damping"
    assert shown.next_step == NextStep("crosscheck", (str(other), str(model)), robot_typed=False)


UNNAMED_LISTS = {
    "constants.py": "Kp = 20.0\nviscous_friction = [{numbers}]\nbias = [{numbers}]\n"
    "rotor_armature = [{short}]\n",
    "constants.yaml": "kp: 20.0\nviscous_friction: [{numbers}]\nbias: [{numbers}]\n"
    "rotor_armature: [{short}]\n",
    "constants.json": '{{"kp": 20.0, "viscous_friction": [{numbers}], "bias": [{numbers}], '
    '"rotor_armature": [{short}]}}',
}
"""{file: text} with a list of joint numbers under an unknown key, a list of another quantity, and a
list that is shorter than the robot's joints."""


@pytest.mark.parametrize("name", UNNAMED_LISTS)
def test_list_with_a_number_per_joint_under_an_unknown_key_is_reported(
    tmp_path: Path, name: str
) -> None:
    """A list of friction is not ignored silently; no number of the list is used."""
    numbers = ", ".join(f"{0.1 + 0.01 * index:g}" for index in range(len(JOINTS)))
    path = tmp_path / name
    path.write_text(UNNAMED_LISTS[name].format(numbers=numbers, short="0.1, 0.2"))
    found = read_contract(URDF, path, stand=False)
    (note,) = (note for note in found.notes if note.code == "contract-lists-not-read")
    assert note.values["keys"] == ("viscous_friction",)
    assert note.values["count"] == len(JOINTS)
    assert {fact.quantity for fact in found.facts if fact.source == name} == {"kp"}
    shown = [getattr(part, "short", "") for part in contract_document(found).findings]
    line = {
        ".py": 'joint_names = ["leg_front_r_1", ...]',
        ".yaml": 'joint_names: ["leg_front_r_1", ...]',
        ".json": '"joint_names": ["leg_front_r_1", ...]',
    }[path.suffix]
    added = f"no joint names: add {line} to the {path.suffix}"
    assert f"{added}, then map the keys (-v)" in shown


def test_list_under_an_unknown_key_is_reported_with_the_key_if_joints_are_named(
    tmp_path: Path,
) -> None:
    """The order is known, but not the quantity; with the key in the user's table, it is read."""
    numbers = ", ".join(["0.1"] * len(JOINTS))
    path = tmp_path / "deploy.yaml"
    path.write_text(
        f"joint_names: [{', '.join(JOINTS)}]\nkps: [{numbers}]\nmotor_friction: [{numbers}]\n"
    )
    found = read_contract(URDF, path, stand=False)
    shown = [getattr(part, "short", "") for part in contract_document(found).findings]
    entry = 'quantity = "friction", names = ["motor_friction"]'
    assert f"pupper-analysis.toml: add a contract.key with {entry}" in shown
    rule = '[[contract.key]]\nquantity = "friction"\nnames = ["motor_friction"]\n'
    (tmp_path / "pupper-analysis.toml").write_text(rule)
    found = read_contract(URDF, path, stand=False)
    assert not [note for note in found.notes if note.code == "contract-lists-not-read"]
    read = [fact for fact in found.facts if fact.source == "deploy.yaml"]
    assert sum(fact.quantity == "friction" for fact in read) == len(JOINTS)


def test_observations_in_another_order_are_found(sources: dict[str, Path]) -> None:
    text = sources["mjlab_cfg.py"].read_text()
    first, second = re.findall(r'            "(?:angles|last)".*\n', text)
    sources["mjlab_cfg.py"].write_text(text.replace(first + second, second + first))
    found = contract(sources["mjlab_cfg.py"], sources["deploy.yaml"])
    assert [finding.kind for finding in found.findings] == ["observations"]


def test_model_values_are_compared_with_other_sources(sources: dict[str, Path]) -> None:
    found = read_contract(MJCF, URDF, sources["policy.json"], stand=False)
    (finding,) = found.findings
    assert (finding.kind, finding.values) == ("kd", (0.25, 0.1))
    assert finding.places[1].rpartition(":")[0].endswith("pupper_v3_shared.xml")
    assert "pupper_v3.xml has 40 % of the damping in policy.json" in finding.message


@pytest.mark.slow
def test_stands_of_default_poses_differ_in_height(sources: dict[str, Path]) -> None:
    """Two default poses differ in base height [mm]; v3 with kp = 5 N m/rad sags by 2 to 20 mm."""
    text = sources["config.yaml"].read_text()
    sources["config.yaml"].write_text(text.replace("0.52", "0.82"))
    found = read_contract(MJCF, URDF, sources["policy.json"], sources["config.yaml"])
    first, second = found.poses
    assert first.source == "policy.json"
    assert first.height != second.height
    assert first.stays
    assert first.sag is not None
    assert 0.002 < first.sag < 0.02  # kp of 5: v3 sinks by some mm
    assert first.utilisation is not None
    assert 0.05 < first.utilisation < 0.3
    finding = next(finding for finding in found.findings if finding.kind == "default angle")
    apart = abs(first.height - second.height)
    assert f"difference of the base height {1e3 * apart:.3g} mm" in finding.message


def test_several_configurations_in_one_file_require_a_name(sources: dict[str, Path]) -> None:
    path = sources["isaac_cfg.py"]
    text = path.read_text()
    path.write_text(text + text.replace("PUPPER_CFG", "OTHER_CFG").replace("3.0", "4.0"))
    with pytest.raises(ModelError, match=r"PUPPER_CFG, OTHER_CFG; select"):
        contract(path)
    assert contract(f"{path}:PUPPER_CFG").findings == ()
    with pytest.raises(ModelError, match="no configuration 'NONE'"):
        contract(f"{path}:NONE")


def test_a_folder_gives_the_deployments_of_this_robot(sources: dict[str, Path]) -> None:
    folder = sources["config.yaml"].parent
    (folder / "other.yaml").write_text(
        "a:\n  ros__parameters:\n    joints: [x, y]\n    kps: [1, 1]\n"
    )
    found = contract(folder)
    assert {source.name for source in found.sources} == {
        "pupper_v3.urdf", "config.yaml:walker", "policy.onnx"}  # fmt: skip


def test_deployment_of_unitree_rl_gym_is_read_and_compared(sources: dict[str, Path]) -> None:
    path = sources["deploy.yaml"].with_name("go.yaml")
    path.write_text(UNITREE_GYM)
    assert contract(sources["gym_cfg.py"], path).findings == ()
    stated = {
        fact.quantity: fact.value for fact in contract(path).facts if fact.source == path.name
    }
    assert {"time step", "decimation", "policy step", "observation ang_vel"} <= set(stated)
    assert stated["policy step"] == pytest.approx(0.02)
    changed = UNITREE_GYM.replace("control_decimation: 4", "control_decimation: 10")
    path.write_text(changed.replace("action_scale: 0.75", "action_scale: 0.25"))
    scale, step = sorted(contract(sources["gym_cfg.py"], path).findings, key=lambda one: one.kind)
    assert (scale.kind, scale.values, len(scale.joints)) == ("action scale", (0.75, 0.25), 12)
    assert (step.kind, step.values) == ("policy step", (0.02, 0.05))
    assert step.places[1] == f"{path}:3"


def test_joint_orders_of_unitree_rl_lab_are_read(sources: dict[str, Path]) -> None:
    """The order of the trainer is by depth; the stiffness of the deployment is by motor, all
    other values in the order of the trainer."""
    folder = sources["isaac_cfg.py"].parent
    path, deploy = folder / "unitree.py", folder / "lab.yaml"
    motors = [*JOINTS[3:6], *JOINTS[:3], *JOINTS[9:], *JOINTS[6:9]]
    text = sources["isaac_cfg.py"].read_text()
    text = text.replace("ArticulationCfg(\n",
                        f"UnitreeArticulationCfg(\n    joint_sdk_names={motors},\n", 1)  # fmt: skip
    path.write_text(text.replace('{"leg_.*": 5.0}', '{"leg_.*_[12]": 5.0, "leg_.*_3": 6.0}'))
    by_depth = [f"leg_{leg}_{number}" for number in (1, 2, 3)
                for leg in ("front_r", "front_l", "back_r", "back_l")]  # fmt: skip
    angles = dict(zip(JOINTS, ANGLES, strict=True))
    deploy.write_text(
        f"joint_ids_map: {format_list(motors.index(joint) for joint in by_depth)}\n"
        f"default_joint_pos: {format_list(angles[joint] for joint in by_depth)}\n"
        f"stiffness: {format_list(6.0 if motor.endswith('3') else 5.0 for motor in motors)}\n"
        f"damping: {format_list([0.25] * 12)}\n"
    )
    found = contract(path, deploy)
    (read,) = [source for source in found.sources if source.role == "deployment"]
    assert (read.order_source, list(read.order)) == ("motors", by_depth)
    assert found.findings == ()
    text = deploy.read_text()
    deploy.write_text(text.replace("stiffness: [5.0, 5.0, 6.0", "stiffness: [5.0, 5.0, 9.0"))
    (finding,) = [
        finding
        for finding in contract(path, deploy).findings
        if finding.probable_mistake != "mirror"
    ]
    assert (finding.kind, finding.joints, finding.values) == ("kp", (motors[2],), (6.0, 9.0))


def test_motor_limits_in_the_order_of_the_motors_are_recognised(tmp_path: Path) -> None:
    """As in RoboMimic_Deploy: gains by depth, ``tau_limit`` by motor. A single wrong value remains
    a finding, since it does not make the order of the policy asymmetric."""
    by_depth = [f"leg_{leg}_{number}" for number in (1, 2, 3)
                for leg in ("front_r", "front_l", "back_r", "back_l")]  # fmt: skip
    limits = {"1": 3.0, "2": 2.0, "3": 1.0}
    gains = {"1": 5.0, "2": 6.0, "3": 7.0}
    deploy = tmp_path / "walk.yaml"

    def read_efforts(limits_as_listed: list[float]) -> tuple[dict[str, float], set[str]]:
        """Return {joint: effort} of the deployment, and the codes of the notes."""
        deploy.write_text(
            f"joint2motor_idx: {format_list(JOINTS.index(joint) for joint in by_depth)}\n"
            f"kps: {format_list(gains[joint[-1]] for joint in by_depth)}\n"
            f"tau_limit: {format_list(limits_as_listed)}\n"
        )
        found = contract(deploy)
        assert {fact.joint: fact.value for fact in found.facts
                if fact.quantity == "kp" and fact.source == "walk.yaml"} == {
                    joint: gains[joint[-1]] for joint in JOINTS}  # fmt: skip
        efforts = {fact.joint: fact.number for fact in found.facts
                   if fact.quantity == "effort" and fact.source == "walk.yaml"}  # fmt: skip
        return efforts, {note.code for note in found.notes}

    expected = {joint: limits[joint[-1]] for joint in JOINTS}
    efforts, notes = read_efforts([limits[joint[-1]] for joint in JOINTS])
    assert efforts == expected
    assert "contract-order-of-motors" in notes
    efforts, notes = read_efforts([limits[joint[-1]] for joint in by_depth])
    assert efforts == expected
    assert "contract-order-of-motors" not in notes
    efforts, notes = read_efforts(
        [9.0 if joint == by_depth[1] else limits[joint[-1]] for joint in by_depth]
    )
    assert efforts == expected | {by_depth[1]: 9.0}
    assert "contract-order-of-motors" not in notes


@pytest.mark.parametrize("given", [[1.0], [1.0] * 11, [1.0] * 13])
def test_list_of_another_length_is_not_assigned_to_joints(
    sources: dict[str, Path], given: list[float]
) -> None:
    alone = sources["deploy.yaml"].with_name("alone.yaml")
    alone.write_text(f"kps: {format_list(given)}\n")
    with pytest.raises(ModelError, match=rf"kp has {len(given)} values for 12 joints"):
        contract(alone)
    for name in ("deploy.yaml", "config.yaml"):  # with motor numbers, and with names
        text = sources[name].read_text()
        sources[name].write_text(text.replace(format_list([5.0] * 12), format_list(given)))
        found = contract(sources["gym_cfg.py"], sources[name])
        assert found.findings == ()
        assert not [fact for fact in found.facts if fact.quantity == "kp"
                    and fact.source.startswith(name)]  # fmt: skip
        (warning,) = found.unread
        assert (warning.code, warning.severity) == ("contract-list-length", "warning")
        assert (warning.values["count"], warning.values["joints"]) == (len(given), 12)
        assert len(warning.sources) == 2  # the list, and the joint order
        lines = sources[name].read_text().splitlines()
        line = next(i for i, text in enumerate(lines, 1) if format_list(given) in text)
        assert f"{name}:{line}: kp has" in str(warning).replace(":walker:", ":")
        assert not found.passed


@pytest.mark.parametrize(
    ("first", "second", "sign", "expected"),
    [
        (math.inf, math.inf, 1, True),
        (math.inf, -math.inf, 1, False),
        (math.inf, -math.inf, -1, True),
        (math.inf, 2.0, 1, False),
        (1.0, 1.0009, 1, True),
        (1.0, 1.002, 1, False),
    ],
)
def test_mirrored_numbers_agree_also_if_both_are_infinite(
    first: float, second: float, sign: int, expected: bool
) -> None:
    """Two limits of inf were reported as no mirror images."""
    assert is_mirror_image(first, second, sign) is expected


def test_contract_without_a_model_is_refused(sources: dict[str, Path]) -> None:
    with pytest.raises(ConfigurationError, match="no source is a model"):
        read_contract(sources["policy.json"])


def test_duplicate_yaml_key_is_refused_and_merged_keys_are_read(
    sources: dict[str, Path],
) -> None:
    path = sources["deploy.yaml"]
    text = path.read_text()
    path.write_text(text + f"damping: {format_list([0.5] * 12)}\n")
    line = text.count("\n") + 1
    with pytest.raises(ModelError, match=rf"deploy\.yaml:{line}: 'damping' occurs twice"):
        contract(path)
    kd = f"damping: {format_list([0.25] * 12)}"
    assert kd in text
    path.write_text("<<: *gains\n" + text.replace(kd, f"gains: &gains {{{kd}}}"))
    with pytest.raises(ModelError, match="undefined alias"):
        contract(path)
    path.write_text(f"gains: &gains {{{kd}}}\n<<: *gains\n{text.replace(kd, '')}")
    found = contract(sources["gym_cfg.py"], path)
    assert found.findings == ()
    stated = {fact.joint: fact.value for fact in found.facts
            if fact.source == path.name and fact.quantity == "kd"}  # fmt: skip
    assert stated == dict.fromkeys(JOINTS, 0.25)


@pytest.mark.parametrize(
    "pattern", ["(.|.)*!", "(a*)*b", "((l|le|leg))+x", "(.*)" * 9 + "x", "(", "a**"]
)
def test_regular_expressions_with_exponential_time_are_left_out(
    sources: dict[str, Path], pattern: str
) -> None:
    """Four patterns backtrack exponentially in `re`, so that the test would not end; two are
    invalid.
    """
    text = sources["isaac_cfg.py"].read_text()
    sources["isaac_cfg.py"].write_text(
        text.replace('{"leg_.*": 5.0}', f'{{"leg_.*": 5.0, "{pattern}": 9.0}}')
    )
    found = contract(sources["isaac_cfg.py"], sources["policy.json"])
    assert found.findings == ()
    (message,) = found.unread
    assert (message.code, message.values["names"]) == ("contract-names-unknown", (pattern,))
    assert not found.passed


def test_mjcf_that_mujoco_cannot_compile_is_compared_by_its_joints(tmp_path: Path) -> None:
    """The note contains MuJoCo's message. Reference: the numbers in the text of the file."""
    path, deploy = tmp_path / "robot.xml", tmp_path / "deploy.yaml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="hip" range="-30 30" armature="0.01"/>'
        '<geom size="0.1"/></body></worldbody>\n'
        '<contact><exclude body1="a" body2="b"/></contact></mujoco>'
    )
    deploy.write_text("joint_names: [hip]\njoint_upper_limits: [0.7]\n")
    found = read_contract(path, deploy, stand=False)
    (finding,) = found.findings
    assert (finding.kind, finding.values) == ("upper limit", (0.7, pytest.approx(math.pi / 6)))
    (note,) = [note for note in found.notes if note.code == "contract-text-alone"]
    assert "'a'" in str(note)
    stated = {fact.quantity: fact.value for fact in found.facts if fact.source == "robot.xml"}
    assert stated["armature"] == 0.01


def test_mjcf_with_an_invalid_joint_is_refused_with_the_message_of_mujoco(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="hip" axis="0 0 0"/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(ModelError, match="MuJoCo cannot compile the MJCF"):
        read_contract(path, stand=False)


PLAYGROUND = """
from ml_collections import config_dict


def default_config() -> config_dict.ConfigDict:
    return config_dict.create(
        ctrl_dt=0.02,
        sim_dt=0.004,
        Kp=5.0,
        Kd=0.25,
        action_scale=0.75,
        noise_config=config_dict.create(level=1.0, scales=config_dict.create(joint_pos=0.03)),
    )
"""


def test_a_flat_table_that_a_function_makes_is_a_trainer(sources: dict[str, Path]) -> None:
    """As in MuJoCo Playground: neither a class nor names of joints."""
    path = sources["gym_cfg.py"].with_name("joystick.py")
    path.write_text(PLAYGROUND)
    found = contract(path, sources["deploy.yaml"])
    assert found.findings == ()
    (read,) = [source for source in found.sources if source.name == "joystick.py:default_config"]
    assert read.role == "trainer"
    path.write_text(PLAYGROUND.replace("Kp=5.0", "Kp=35.0").replace("ctrl_dt=0.02", "ctrl_dt=0.01"))
    kp, step = sorted(contract(path, sources["deploy.yaml"]).findings, key=lambda one: one.kind)
    assert (kp.kind, kp.values, len(kp.joints)) == ("kp", (35.0, 5.0), 12)
    assert (step.kind, step.values) == ("policy step", (0.01, 0.02))
    line = PLAYGROUND.splitlines().index("        Kp=5.0,") + 1
    assert kp.places[0] == f"{path}:{line}"


def test_a_usd_with_other_names_is_matched_by_structure(tmp_path: Path) -> None:
    from lxml import etree

    from pupper_analysis.models.loading import reader_of
    from tests.tools.usd import written

    path, other = written.write(tmp_path), tmp_path / "other.urdf"
    reader = reader_of(path)
    assert reader is not None
    root = reader.read_as_urdf(path).root
    text = etree.tostring(root).decode()
    for name, new in {"hip": "m1", "knee": "m2", "spring": "m3"}.items():
        text = text.replace(f'<joint name="{name}"', f'<joint name="{new}"')
    for number, link in enumerate(re.findall(r'<link name="([^"]*)"', text)):
        text = text.replace(f'"{link}"', f'"body{number}"')
    other.write_text(text)
    found = read_contract(path, other, stand=False)
    assert any(note.code == "contract-matched" for note in found.notes)
    lower = {(fact.source, fact.joint) for fact in found.facts if fact.quantity == "lower limit"}
    assert lower == {
        (name, joint) for name in (path.name, "other.urdf") for joint in ("hip", "knee", "spring")
    }
    assert [finding.message for finding in found.findings] == []


def test_motor_limits_are_compared_with_the_urdf(sources: dict[str, Path]) -> None:
    text = sources["isaac_cfg.py"].read_text()
    sources["isaac_cfg.py"].write_text(text.replace("effort_limit=3.0", "effort_limit=2.0"))
    (finding,) = contract(sources["isaac_cfg.py"]).findings
    assert (finding.kind, finding.values, finding.joints) == ("effort", (2.0, 3.0), tuple(JOINTS))


def test_an_observation_in_another_joint_order_is_a_finding(sources: dict[str, Path]) -> None:
    """Reference: the joint names of the deployment, with both back legs exchanged."""
    text = sources["config.yaml"].read_text()
    swapped = [*JOINTS[:6], *JOINTS[9:], *JOINTS[6:9]]
    sources["config.yaml"].write_text(text.replace(format_list(JOINTS), format_list(swapped)))
    found = contract(sources["policy.onnx"], sources["config.yaml"])
    orders = [finding for finding in found.findings if finding.kind == "order"]
    assert len(orders) == 1
    assert set(orders[0].joints) == set(JOINTS[6:])
    assert "6 → 9 (leg_back_r_1)" in orders[0].message


def test_table_of_a_quantity_contains_the_numbers_of_this_quantity_only(
    sources: dict[str, Path],
) -> None:
    """Reference: the facts; each table has the value of each joint in each source."""
    found = contract(sources["deploy.yaml"], sources["config.yaml"])
    blocks = contract_document(found).blocks
    for quantity in ("kp", "default angle"):
        (table,) = (
            block for block in blocks if isinstance(block, Table) and block.title == word(quantity)
        )
        names = [column.name.text for column in table.columns[1:]]  # type: ignore[union-attr]
        shown = {
            (row[0].text, name): cell.value  # type: ignore[union-attr]
            for row in table.rows
            for name, cell in zip(names, row[1:], strict=True)
            if isinstance(cell, Number)
        }
        stated = {
            (fact.joint, fact.source): fact.value
            for fact in found.facts
            if fact.quantity == quantity and fact.joint and fact.value is not None
        }
        assert stated
        assert shown == stated


def test_places_of_a_table_have_the_file_of_each_line(sources: dict[str, Path]) -> None:
    """A source with numbers in two files and at a prim: a line belongs to its own file."""
    found = contract(sources["deploy.yaml"])
    numbers = [fact for fact in found.facts if fact.quantity == "kp" and fact.joint][:4]
    places = ("/a/env.py:3", "/a/env.py:4", "/b/robot.py:9", "/b/robot.usda:</Robot/hip>")
    facts = tuple(replace(fact, place=place) for fact, place in zip(numbers, places, strict=True))
    (table,) = (
        block
        for block in contract_document(replace(found, facts=facts, findings=())).blocks
        if isinstance(block, Table) and block.title == word("kp")
    )
    shown = " ".join(str(note) for note in table.notes)
    assert "env.py:3-4; robot.py:9; robot.usda:</Robot/hip>" in shown


def test_files_with_the_same_name_are_distinguished_by_their_folders(
    sources: dict[str, Path],
) -> None:
    real = sources["deploy.yaml"].parent / "real" / "deploy.yaml"
    real.parent.mkdir()
    text = sources["deploy.yaml"].read_text()
    real.write_text(text.replace("step_dt: 0.02", "step_dt: 0.01"))
    found = contract(sources["gym_cfg.py"], sources["deploy.yaml"], real)
    names = {source.name for source in found.sources if source.role == "deployment"}
    assert names == {f"{real.parents[1].name}/deploy.yaml", "real/deploy.yaml"}
    assert {finding.sources[1] for finding in found.findings} == {"real/deploy.yaml"}
    gains = [fact for fact in found.facts if fact.quantity == "kp"]
    assert len([gain for gain in gains if gain.source == "real/deploy.yaml"]) == 12


def test_yaml_with_the_settings_of_legged_gym_is_a_trainer(sources: dict[str, Path]) -> None:
    """As in HumanoidVerse: names, lists of limits, and gains by parts of joint names."""
    path = sources["deploy.yaml"].with_name("robot.yaml")
    path.write_text(
        f"robot:\n  dof_names: {format_list(JOINTS)}\n"
        f"  dof_effort_limit_list: {format_list([3.0] * 12)}\n"
        "  init_state:\n    default_joint_angles:\n"
        + "".join(f"      {one}: {at}\n" for one, at in zip(JOINTS, ANGLES, strict=True))
        + "  control:\n    stiffness: {leg: 5.0, _3: 6.0}\n    action_scale: 0.75\n"
    )
    found = contract(path, sources["policy.json"])
    (read,) = [source for source in found.sources if source.path == str(path)]
    assert (read.role, read.order_source) == ("trainer", "named")
    (finding,) = found.findings
    assert (finding.kind, finding.values) == ("kp", (6.0, 5.0))
    assert set(finding.joints) == set(JOINTS[2::3])


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("trainer", ["mjlab_cfg.py", "isaac_cfg.py", "gym_cfg.py"])
def test_sources_that_agree_have_no_finding(
    sources: dict[str, Path], trainer: str, other: str
) -> None:
    found = contract(sources[trainer], sources[other])
    assert [finding.message for finding in found.findings] == []
    assert found.passed
    kp = {(fact.source, fact.joint): fact.value for fact in found.facts if fact.quantity == "kp"}
    assert len(kp) == 24
    assert set(kp.values()) == {5.0}


def test_coarsely_rounded_angle_is_a_difference(sources: dict[str, Path]) -> None:
    """0.3 is no rounding of 0.26."""
    text = sources["config.yaml"].read_text()
    sources["config.yaml"].write_text(text.replace("0.26", "0.3"))
    (finding,) = contract(sources["gym_cfg.py"], sources["config.yaml"]).findings
    assert finding.kind == "default angle"
    assert len(finding.joints) == 4


def test_expression_without_a_value_is_shown_as_written(sources: dict[str, Path]) -> None:
    text = sources["isaac_cfg.py"].read_text()
    sources["isaac_cfg.py"].write_text(text.replace("damping=0.25", "damping=measured()"))
    found = contract(sources["isaac_cfg.py"], sources["policy.json"])
    kd = [fact for fact in found.facts if fact.quantity == "kd" and fact.value is None]
    assert {fact.expression for fact in kd} == {"measured()"}
    assert len(kd) == 12
    assert [finding for finding in found.findings if finding.kind == "kd"] == []


def test_limits_of_moveit_count_if_they_are_enabled(sources: dict[str, Path]) -> None:
    path = sources["joint_limits.yaml"]
    found = contract(path)
    assert found.findings == ()
    limits = {
        (fact.joint[-9:], fact.quantity): fact.value
        for fact in found.facts
        if fact.source == path.name
    }
    assert limits == {("front_r_1", "effort"): 3.0, ("front_r_2", "effort"): 3.0}
    text = path.read_text().replace("has_velocity_limits: false", "has_velocity_limits: true")
    path.write_text(text.replace("max_effort: 3.0}", "max_effort: 4.5}"))
    effort, velocity = sorted(contract(path).findings, key=lambda one: one.kind)
    assert (effort.kind, effort.values, effort.joints) == ("effort", (4.5, 3.0), (JOINTS[1],))
    assert (velocity.kind, velocity.joints) == ("velocity", (JOINTS[0],))
    assert velocity.places[0] == f"{path}:4"


def test_missing_effort_limit_of_a_model_is_one_finding(tmp_path: Path) -> None:
    """As `crosscheck` reports it; a limited motor and a joint without a motor are no finding."""
    joints = ("hip", "knee", "ankle", "toe")
    bodies = "".join(
        f'<body pos="0 0 -0.1"><joint name="{joint}" axis="0 1 0"/><geom size="0.02"/>'
        for joint in joints
    )
    actuators = (
        '<position joint="hip" kp="30"/>\n<motor name="knee_motor" joint="knee"/>\n'
        '<motor joint="ankle" forcerange="-9 9"/>'
    )
    model, driver = tmp_path / "leg.xml", tmp_path / "driver.yaml"
    model.write_text(
        f"<mujoco><worldbody>{bodies}{'</body>' * 4}</worldbody>\n"
        f"<actuator>\n{actuators}\n</actuator></mujoco>"
    )
    driver.write_text(
        "joint_names: [hip, knee, ankle, toe]\ntorque_limits: [20.0, 25.0, 9.0, 3.0]\n"
    )
    found = read_contract(model, driver, stand=False)
    (finding,) = found.findings
    assert finding.diagnostic.code == "contract-effort-unlimited"
    assert finding.joints == ("hip", "knee")
    assert finding.values == (20.0, None)
    assert [place.rpartition(":")[2] for place in finding.places] == ["2", "3"]
    assert "20 N m to 25 N m in driver.yaml, no limit in leg.xml" in finding.message
    assert not found.passed
    urdf = tmp_path / "leg.urdf"
    parents, efforts = ("base", *joints), (20, 25, 9, 3)
    body = (
        '<inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    urdf.write_text(
        '<robot name="leg"><link name="base"/>'
        + "".join(
            f'<link name="{joint}">{body}</link>'
            f'<joint name="{joint}" type="revolute"><origin xyz="0 0 -0.1"/>'
            f'<parent link="{parent}"/><child link="{joint}"/><axis xyz="0 1 0"/>'
            f'<limit lower="-3" upper="3" effort="{effort}" velocity="9"/></joint>'
            for parent, joint, effort in zip(parents, joints, efforts, strict=False)
        )
        + "</robot>"
    )
    efforts_differ = [
        difference
        for difference in compare_files(urdf, model).result.differences
        if difference.kind == "effort"
    ]
    subjects = [finding.diagnostic.subject for finding in efforts_differ]
    assert {subject.name for subject in subjects if subject} >= {"hip", "knee"}


def get_tables(contract: Contract) -> dict[str, Table]:
    """Return {title: table} of the document of a contract."""
    blocks = contract_document(contract).blocks
    return {get_english(block.title): block for block in blocks if isinstance(block, Table)}


def test_poses_are_printed_under_their_headers(sources: dict[str, Path]) -> None:
    """A pose with five different numbers; the units are mm and %."""
    found = contract(sources["policy.json"])
    pose = DefaultPoseStand("one.yaml", 0.2, 0.003, 0.45, stays=False, problem=None)
    (row,) = get_tables(replace(found, poses=(pose,)))[
        "Stand in the default pose of each source, with the gains of the source"
    ].rows
    assert [get_english(row[0]), get_english(row[4])] == ["one.yaml", "does not stay up"]
    assert [cell.value for cell in row[1:4] if isinstance(cell, Number)] == [200.0, 3.0, 45.0]


def test_numbers_of_each_source_are_in_the_column_of_the_source(sources: dict[str, Path]) -> None:
    """kd is 0.25 in the policy and 0.1 in the MJCF: each column has its number."""
    found = read_contract(MJCF, URDF, sources["policy.json"], stand=False)
    table = get_tables(found)["kd"]
    names = [get_english(column.name) for column in table.columns[1:]]
    values = {
        name: {cell.value for row in table.rows if isinstance(cell := row[number], Number)}
        for number, name in enumerate(names, start=1)
    }
    assert values == {"policy.json": {0.25}, "pupper_v3.xml": {0.1}}
    finding = next(
        block for block in contract_document(found).blocks if isinstance(block, FileFinding)
    )
    files = [get_english(column.place).partition(":")[0] for column in finding.columns]
    assert files == ["policy.json", "pupper_v3_shared.xml"]
    rows = {get_english(row[0]): row for row in get_tables(found)["Sources"].rows}
    counts = {name: row[2].value for name, row in rows.items() if isinstance(row[2], Number)}
    assert counts == {
        source.name: sum(fact.source == source.name for fact in found.facts)
        for source in found.sources
    }


def test_a_single_source_is_only_compared_with_its_mirror_image() -> None:
    shown = contract_document(read_contract(MJCF, stand=False))
    findings = [getattr(part, "short", "") or get_english(part) for part in shown.findings]
    assert findings[:2] == [
        "0 left-right differences in pupper_v3.xml",
        "one source: no other source to compare",
    ]


def test_values_without_a_quoted_line_are_those_of_their_source(sources: dict[str, Path]) -> None:
    """kd is 0.25 in the policy and 0.1 in the MJCF; the files are gone, so that no line is
    quoted."""
    found = read_contract(MJCF, URDF, sources["policy.json"], stand=False)
    (finding,) = found.findings
    found = replace(found, findings=(replace(finding, places=("gone.json:1", "gone.xml:2")),))
    block = next(
        block for block in contract_document(found).blocks if isinstance(block, FileFinding)
    )
    assert [get_english(column.line) for column in block.columns] == [
        "0.25 N m s/rad",
        "0.1 N m s/rad",
    ]


def write_deployment(path: Path, **rows: object) -> Path:
    """Write a deployment that names the joints and states kp = 5, with changed or further rows."""
    kept = {"joint_names": format_list(JOINTS), "kps": format_list([5.0] * 12), **rows}
    path.write_text("".join(f"{key}: {row}\n" for key, row in kept.items()))
    return path


@pytest.mark.parametrize("table", ['{".*_3": 7.0, ".*_[12]": 5.0}', '{".*": 5.0, ".*_3": 7.0}'])
def test_a_table_of_patterns_beside_joint_names_is_compared(tmp_path: Path, table: str) -> None:
    """The list of joint names must not hide numbers whose keys are patterns."""
    first = write_deployment(tmp_path / "first.yaml")
    second = write_deployment(tmp_path / "second.yaml", kps=table)
    (finding,) = contract(first, second).findings
    assert (finding.kind, finding.values) == ("kp", (5.0, 7.0))
    assert set(finding.joints) == {name for name in JOINTS if name.endswith("_3")}


def test_a_table_with_other_names_than_the_joint_names_is_reported(tmp_path: Path) -> None:
    """Numbers of keys that match no joint are lost for the comparison."""
    first = write_deployment(tmp_path / "first.yaml")
    table = ", ".join(f"{name[4:]}: 7.0" for name in JOINTS)
    second = write_deployment(tmp_path / "second.yaml", kps=f"{{{table}}}")
    found = contract(first, second)
    assert not found.passed
    assert {message.code for message in found.unread} == {"contract-quantity-lost"}


@pytest.mark.parametrize(
    ("key", "number", "is_reported"),
    [("kps", 5.0, True), ("default_joint_pos", 0.0, True), ("torque_limits", 3.0, False),
     ("velocity_limits", 9.0, False)],
)  # fmt: skip
def test_an_infinite_number_agrees_with_no_finite_number(
    tmp_path: Path, key: str, number: float, is_reported: bool
) -> None:
    """An infinite limit of a motor is no limit; an infinite gain or angle is a mistake."""
    first = write_deployment(tmp_path / "first.yaml", **{key: format_list([number] * 12)})
    second = write_deployment(tmp_path / "second.yaml", **{key: format_list([".inf"] * 12)})
    both = (first.name, second.name)
    found = [finding for finding in contract(first, second).findings if finding.sources == both]
    assert bool(found) == is_reported
    assert all(finding.values == (number, math.inf) for finding in found)


@pytest.mark.parametrize(
    ("numbers", "moved"),
    [([*range(12)], 0), ([*range(1, 13)], 0), ([3, 4, 5, 0, 1, 2, *range(6, 12)], 6),
     ([*range(11), 11.5], None), ([0] * 12, None)],
)  # fmt: skip
def test_other_motor_numbers_of_named_joints_are_reported(
    tmp_path: Path, numbers: list[float], moved: int | None
) -> None:
    """Reference: the exchanged motors. Numbers from 1 on are the same motors."""
    first = write_deployment(tmp_path / "first.yaml", joint_ids_map=format_list(range(12)))
    second = write_deployment(tmp_path / "second.yaml", joint_ids_map=format_list(numbers))
    found = contract(first, second)
    assert found.passed == (moved == 0)
    assert [len(finding.joints) for finding in found.findings] == ([moved] if moved else [])
    codes = {note.code for note in found.unread}
    assert ("contract-motors-unread" in codes) == (moved is None)


@pytest.mark.parametrize("text", ["010", "-0017", "0_12"])
def test_an_octal_number_is_not_read_as_a_decimal_number(tmp_path: Path, text: str) -> None:
    """PyYAML and yaml-cpp read 010 as 8; readers of YAML 1.2 read 10."""
    first = write_deployment(tmp_path / "first.yaml")
    second = write_deployment(tmp_path / "second.yaml", kps=format_list([text] * 12))
    found = contract(first, second)
    assert found.findings == ()
    assert {note.code for note in found.unread} == {"contract-value-unread"}


@pytest.mark.parametrize("number", ["Infinity", "-Infinity", "inf", ".inf", "-.Inf"])
def test_an_infinite_gain_of_json_or_yaml_is_compared(tmp_path: Path, number: str) -> None:
    """Python's ``json`` writes ``Infinity``, which YAML reads as a text."""
    first = write_deployment(tmp_path / "first.yaml")
    second = write_deployment(tmp_path / "second.yaml", kps=number)
    (finding,) = contract(first, second).findings
    assert finding.values == (5.0, float(number.replace(".", "")))


@pytest.mark.parametrize("last", ["3", "null", "''"])
def test_joint_names_that_are_no_texts_make_the_contract_incomplete(
    tmp_path: Path, last: str
) -> None:
    """Without the names, the order of the lists is assumed."""
    first = write_deployment(tmp_path / "first.yaml")
    names = format_list([*JOINTS[:11], last])
    second = write_deployment(tmp_path / "second.yaml", joint_names=names)
    found = contract(first, second)
    assert not found.passed
    assert "contract-names-unread" in {message.code for message in found.unread}


def test_a_network_without_outputs_differs_from_twelve_actions(tmp_path: Path) -> None:
    first = write_deployment(tmp_path / "first.yaml", num_actions=12)
    second = tmp_path / "policy.json"
    second.write_text('{"kps": 5.0, "in_shape": [], "layers": [{"shape": [null, 0]}]}')
    (finding,) = contract(first, second).findings
    assert (finding.kind, set(finding.values)) == ("actions", {0.0, 12.0})


def test_an_empty_range_is_no_narrower_range_of_the_model(tmp_path: Path) -> None:
    """A lower limit above the upper limit permits no position at all."""
    limits = {"joint_lower_limits": 0.1, "joint_upper_limits": 0.2}
    for factor, severity in ((1, "note"), (-1, "warning")):
        rows = {key: format_list([factor * number] * 12) for key, number in limits.items()}
        path = write_deployment(tmp_path / "deploy.yaml", **rows)
        assert {finding.severity.value for finding in contract(path).findings} == {severity}


def test_action_offsets_of_a_deployment_are_compared(tmp_path: Path) -> None:
    """The same action commands positions that differ by the offsets."""
    first = write_deployment(tmp_path / "first.yaml", action_offset=format_list(ANGLES))
    moved = [0.36, *ANGLES[1:]]
    second = write_deployment(tmp_path / "second.yaml", action_offset=format_list(moved))
    both = (first.name, second.name)
    (finding,) = [
        finding for finding in contract(first, second).findings if finding.sources == both
    ]
    assert (finding.kind, finding.joints) == ("action offset", (JOINTS[0],))


@pytest.mark.parametrize("index", [0, 3, 11])
def test_a_text_in_a_list_without_joint_names_is_reported(tmp_path: Path, index: int) -> None:
    """The order is assumed from the left-right pairs, of which one number is missing."""
    numbers: list[object] = [0.1] * 12
    numbers[index] = "*a" if index == 3 else "x"
    path = tmp_path / "deploy.json"
    path.write_text(json.dumps({"default_joint_pos": ANGLES, "kds": numbers}))
    found = contract(path, write_deployment(tmp_path / "first.yaml", kds=0.1))
    assert {message.code for message in found.unread} == {"contract-side-missing"}
    assert not found.passed
