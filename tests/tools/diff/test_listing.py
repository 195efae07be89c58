"""Geoms, pairs, options and keyframes of an MJCF: compiled values with their lines."""

from __future__ import annotations

from pathlib import Path

import mujoco

from pupper_analysis.models.attributes import ELEMENT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.tools.diff.elements import ENABLED_WORD, list_elements

TEXT = """<mujoco>
  <option timestep="0.003" cone="elliptic">
    <flag contact="disable" energy="enable"/>
  </option>
  <default>
    <geom margin="0.001"/>
    <default class="foot">
      <geom friction="0.7 0.1 0.2" condim="4"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="a">
      <freejoint/>
      <geom size="0.1" contype="0" conaffinity="0"/>
      <geom class="foot" size="0.02" pos="0 0 -0.2"/>
    </body>
    <body name="b" pos="1 0 0"><joint/><geom name="box" type="box" size="0.1 0.2 0.3"/></body>
  </worldbody>
  <contact>
    <pair geom1="floor" geom2="box" friction="0.3 0.3 0.01 0.01 0.01"/>
    <exclude body1="a" body2="b"/>
  </contact>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.5"/></keyframe>
</mujoco>
"""


def test_element_values_equal_compiled_values_with_their_lines(tmp_path: Path) -> None:
    file = tmp_path / "r.xml"
    file.write_text(TEXT)
    found = list_elements(read_mjcf(file))
    foot = found["geom", "a #2"]
    assert foot.values["friction"] == (0.7, 0.1)  # condim 4 has no rolling friction
    assert foot.values["margin"] == (0.001,)
    assert (foot.place("friction").line, foot.place("margin").line) == (8, 6)
    assert (foot.place("shape").line, foot.place("solref").line) == (16, 16)
    assert not found["geom", "a #1"].touches
    assert found["pair", "box and floor"].values["friction"][:2] == (0.3, 0.3)
    assert found["pair", "box and floor"].place("").line == 21
    assert found["exclude", "a and b"].place("").line == 22
    option = found["option", "option"]
    assert (option.values["timestep"], option.place("timestep").line) == ((0.003,), 2)
    flags = {
        name: one.values[ENABLED_WORD] for (kind, name), one in found.items() if kind == "flag"
    }
    assert (flags["contact"], flags["energy"], flags["gravity"]) == ((0.0,), (1.0,), (1.0,))
    assert found["key", "home"].values["qpos"] == (0, 0, 1, 1, 0, 0, 0, 0.5)


def test_each_array_of_contacts_and_options_of_mujoco_has_a_row() -> None:
    """Reference: the arrays of MuJoCo's model.

    An array of a new version must be compared, or be listed here with a reason.
    """
    apart = {
        "geom": {"type", "size", "pos", "quat", "dataid",  # the shape
                 "aabb", "rbound", "sameframe", "bodyid",  # made of others
                 "matid", "rgba", "group", "user", "castshadow",  # seen
                 "fluid", "plugin"},  # of what acts on the robot
        "pair": {"dim", "geom1", "geom2", "signature"},  # condim; whom it is of
        "key": set(),
        "joint": {"type", "limited", "actfrclimited", "range", "actfrcrange", "axis", "pos",
                  "stiffness", "stiffnesspoly", "springyield", "actgravcomp",  # of trees, springs
                  "bodyid", "qposadr", "dofadr", "actuatorid", "plasticadr",  # made of others
                  "group", "user"},  # seen
        "dof": {"armature", "damping", "dampingpoly", "frictionloss",
                "M0", "Madr", "bodyid", "invweight0", "jntid", "length", "parentid", "simplenum",
                "treeid"},
        "tendon": {"stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature",
                   "frictionloss", "range", "limited", "lengthspring", "actfrclimited",
                   "springyield", "type",
                   "actuatorid", "adr", "invweight0", "length0", "num", "plasticadr", "treeid",
                   "treenum", "group", "matid", "rgba", "user", "width"},
        "actuator": {"gear", "gainprm", "biasprm", "ctrlrange", "ctrllimited", "forcerange",
                     "forcelimited", "armature", "damping", "dampingpoly", "trnid", "trntype",
                     "acc0", "actadr", "actnum", "ctrladr", "ctrlnum", "ctrlspec", "historyadr",
                     "length0", "lengthrange", "outadr", "outnum", "plugin", "group", "user"},
        "eq": {"data", "active0", "type", "obj1id", "obj2id", "objtype"},
        "option": {"gravity", "wind", "density", "viscosity",  # of what acts on the robot
                   "disableflags", "enableflags"},  # flags
    }  # fmt: skip
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    for element, others in apart.items():
        start = {"option": "", "joint": "jnt_"}.get(element, f"{element}_")
        owner = model.opt if element == "option" else model
        names = {name.removeprefix(start) for name in dir(owner) if name.startswith(start)}
        names = {name for name in names if not name.startswith("_")}
        rows = {
            row.mujoco.removeprefix(start)
            for row in ELEMENT_ATTRIBUTES
            if (element == "option" and row.element == element)
            or (element != "option" and row.mujoco.startswith(start))
        }
        assert names == rows | others | (rows & others), element


def test_lines_of_pairs_and_excludes_are_their_own_in_any_order(tmp_path: Path) -> None:
    """MuJoCo sorts both; the margin of each compiled pair is in its line, as are the bodies."""
    bodies = "".join(
        f'<body name="{name}"><joint/><geom name="g{name}" size="0.1"/></body>' for name in "abc"
    )
    ends = (("c", "b", 0.1), ("a", "c", 0.2), ("a", "b", 0.3))
    pairs = "\n".join(f'<pair geom1="g{a}" geom2="g{b}" margin="{m}"/>' for a, b, m in ends)
    excludes = "\n".join(f'<exclude body1="{a}" body2="{b}"/>' for a, b, _ in ends)
    file = tmp_path / "r.xml"
    file.write_text(
        f"<mujoco><worldbody>{bodies}</worldbody>\n"
        f"<contact>\n{pairs}\n{excludes}\n</contact></mujoco>"
    )
    lines, found = file.read_text().splitlines(), list_elements(read_mjcf(file))
    for a, b, margin in ends:
        pair = found["pair", " and ".join(sorted((f"g{a}", f"g{b}")))]
        assert pair.values["margin"] == (margin,)
        assert f'margin="{margin}"' in lines[(pair.place("margin").line or 0) - 1]
        exclude = found["exclude", " and ".join(sorted((a, b)))]
        assert f'body1="{a}" body2="{b}"' in lines[(exclude.place("").line or 0) - 1]
