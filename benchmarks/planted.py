"""Plant single defects in public URDFs and count what ``audit`` makes of them.

    python benchmarks/planted.py --robots FOLDER --seed 1 --csv docs/data/planted-defects.csv

FOLDER is a site-packages folder with public robots (see benchmarks/corpus.py). Each defect is one
of the 17 kinds of the benchmark of simcheck 0.2.0, written into a copy of a published file. The
seed chooses kinds and elements; no test uses the result. The findings of the published file are
subtracted, and of the remaining findings the first in the order of ``audit`` is judged:

- ``found``: a remaining finding names the edited link or joint, or the joint that moves the link;
- ``first``: the first remaining finding does so, by a rule that names the cause (`KINDS`);
- ``unique``: the published value follows from the file, see `is_unique`;
- ``remedy``: the single repair of this finding restores the published values within 2 %.

Each robot is also written with edits that do not change it (`HARMLESS`). Each finding that the
published file does not have is then a false alarm.
"""

from __future__ import annotations

import math
import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from corpus import DATA
from lxml import etree
from tables import write_csv

import pupper_analysis as pa

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.sides import find_mirror_pairs, strip_sides
from pupper_analysis.models.stated.model import UrdfModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfLink
from pupper_analysis.tools.audit.audit import Audit, Finding
from pupper_analysis.tools.audit.fix import apply_repairs
from pupper_analysis.tools.audit.registry import list_extent_points

ROBOTS = {
    "a1": f"{DATA}/a1_description/urdf/a1.urdf",
    "go1": f"{DATA}/go1_description/urdf/go1.urdf",
    "go2": f"{DATA}/go2_description/urdf/go2.urdf",
    "b1": f"{DATA}/b1_description/urdf/b1.urdf",
    "laikago": f"{DATA}/laikago_description/urdf/laikago.urdf",
    "solo12": f"{DATA}/solo_description/robots/solo12.urdf",
    "anymal_b": f"{DATA}/anymal_b_simple_description/robots/anymal.urdf",
    "hyq": f"{DATA}/hyq_description/robots/hyq_no_sensors.urdf",
    "solo": f"{DATA}/solo_description/robots/solo.urdf",
    "b1_z1": f"{DATA}/b1_description/urdf/b1-z1.urdf",
    "g1": f"{DATA}/g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "talos": f"{DATA}/talos_data/robots/talos_reduced.urdf",
    "bolt": f"{DATA}/bolt_description/robots/bolt.urdf",
    "alexander": f"{DATA}/alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf",
    "panda": f"{DATA}/panda_description/urdf/panda.urdf",
    "ur5": f"{DATA}/ur_description/urdf/ur5_robot.urdf",
    "z1": f"{DATA}/z1_description/urdf/z1.urdf",
    "xarm7": f"{DATA}/xarm_description/urdf/xarm7.urdf",
    "kinova": f"{DATA}/kinova_description/robots/kinova.urdf",
    "so101": f"{DATA}/so_arm_description/urdf/so101.urdf",
}
"""{robot: URDF in the folder of packages}: ten quadrupeds, four bipeds and humanoids, six arms."""

Element = etree._Element
TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of <inertia>."""


@dataclass(frozen=True)
class Site:
    """Copy of a URDF, and the element that is edited.

    Attributes:
        root: Root element of the copy.
        rng: Random numbers.
        sizes: {link: largest extent of its shapes [m]} of the published file.
    """

    root: Element
    rng: random.Random
    sizes: Mapping[str, float]

    def list_joints(self, *types: str) -> list[Element]:
        """Return the joints of some types."""
        return [joint for joint in self.root.findall("joint") if joint.get("type") in types]

    def list_moving_links(self, path: str) -> list[Element]:
        """Return the links that a joint moves, and that contain an element at a path."""
        moving = self.list_joints("revolute", "prismatic", "continuous")
        names = {joint.find("child").get("link") for joint in moving}
        links = [link for link in self.root.findall("link") if link.get("name") in names]
        return [link for link in links if link.find(path) is not None]

    def choose(self, elements: list[Element]) -> Element | None:
        """Return a random element; None without elements."""
        return self.rng.choice(elements) if elements else None


def read_numbers(element: Element, name: str, default: str = "0 0 0") -> list[float]:
    """Return the numbers of an attribute."""
    return [float(text) for text in element.get(name, default).split()]


def write_numbers(element: Element, name: str, values: list[float]) -> None:
    """Write numbers to an attribute."""
    element.set(name, " ".join(f"{value:.10g}" for value in values))


def shift_origin(element: Element, axis: int, distance: float) -> None:
    """Translate the <origin> of an element along an axis [m]; add the origin if it is missing."""
    origin = element.find("origin")
    if origin is None:
        origin = etree.Element("origin", xyz="0 0 0", rpy="0 0 0")
        element.insert(0, origin)
    xyz = read_numbers(origin, "xyz")
    xyz[axis] += distance
    write_numbers(origin, "xyz", xyz)


def scale_lengths(site: Site, factor: float) -> str | None:
    """Scale all origins, sizes of shapes and meshes."""
    for element in site.root.iter(etree.Element):
        words = {
            "origin": ("xyz",),
            "box": ("size",),
            "sphere": ("radius",),
            "cylinder": ("radius", "length"),
            "capsule": ("radius", "length"),
            "mesh": ("scale",),
        }
        for word in words.get(element.tag, ()):
            if element.tag == "mesh" or element.get(word):
                values = read_numbers(element, word, "1 1 1")
                write_numbers(element, word, [factor * value for value in values])
    return ""


def reverse_axis(site: Site) -> str | None:
    """Change the sign of the axis of a joint with limits."""
    joint = site.choose(site.list_joints("revolute", "prismatic"))
    if joint is None:
        return None
    axis = joint.find("axis")
    if axis is None:
        axis = etree.SubElement(joint, "axis", xyz="1 0 0")
    write_numbers(axis, "xyz", [0.0 - value for value in read_numbers(axis, "xyz", "1 0 0")])
    return str(joint.get("name"))


def clear_axis(site: Site) -> str | None:
    """Write an axis of zeros."""
    joint = site.choose(site.list_joints("revolute", "prismatic", "continuous"))
    if joint is None:
        return None
    axis = joint.find("axis")
    if axis is None:
        axis = etree.SubElement(joint, "axis")
    axis.set("xyz", "0 0 0")
    return str(joint.get("name"))


def list_limited_joints(site: Site, width: float, *types: str) -> list[Element]:
    """Return the joints with a range wider than ``width`` [rad or m]."""
    return [
        joint
        for joint in site.list_joints(*types)
        if (limit := joint.find("limit")) is not None
        and float(limit.get("upper", 0)) - float(limit.get("lower", 0)) > width
    ]


def exchange_limits(site: Site) -> str | None:
    """Exchange lower and upper limit."""
    joint = site.choose(list_limited_joints(site, 0.0, "revolute", "prismatic"))
    if joint is None:
        return None
    limit = joint.find("limit")
    lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
    limit.set("lower", upper)
    limit.set("upper", lower)
    return str(joint.get("name"))


def write_limits_in_degrees(site: Site) -> str | None:
    """Write the limits of a joint in degrees."""
    joint = site.choose(list_limited_joints(site, 0.3, "revolute"))
    if joint is None:
        return None
    limit = joint.find("limit")
    for word in ("lower", "upper"):
        limit.set(word, f"{math.degrees(float(limit.get(word, 0))):.6g}")
    return str(joint.get("name"))


def edit_inertia(edit: Callable[[Element, list[float]], None]) -> Callable[[Site], str | None]:
    """Return a defect that edits the inertia tensor of a moving link."""

    def plant(site: Site) -> str | None:
        link = site.choose(site.list_moving_links("inertial/inertia"))
        if link is None:
            return None
        tensor = link.find("inertial/inertia")
        moments = [float(tensor.get(word, 0)) for word in ("ixx", "iyy", "izz")]
        if min(moments) <= 0:
            return None
        edit(tensor, moments)
        return str(link.get("name"))

    return plant


def clear_tensor(tensor: Element, _: list[float]) -> None:
    """Write a tensor of zeros."""
    for word in TENSOR:
        tensor.set(word, "0")


def enlarge_moment(tensor: Element, moments: list[float]) -> None:
    """Write izz = 3 (ixx + iyy), and products of zero."""
    tensor.set("izz", f"{3 * (moments[0] + moments[1]):.6g}")
    for word in ("ixy", "ixz", "iyz"):
        tensor.set(word, "0")


def negate_moment(tensor: Element, moments: list[float]) -> None:
    """Change the sign of ixx."""
    tensor.set("ixx", f"{-moments[0]:.10g}")


def write_grams(site: Site) -> str | None:
    """Write mass and inertia of a moving link in g and g m^2."""
    link = site.choose(site.list_moving_links("inertial/mass"))
    if link is None:
        return None
    for element in (link.find("inertial/mass"), link.find("inertial/inertia")):
        for word in element.attrib if element is not None else ():
            element.set(word, f"{1000 * float(element.get(word)):.10g}")
    return str(link.get("name"))


def clear_mass(site: Site) -> str | None:
    """Write a mass of zero, and keep the inertia."""
    link = site.choose(site.list_moving_links("inertial/mass"))
    if link is None:
        return None
    link.find("inertial/mass").set("value", "0")
    return str(link.get("name"))


def remove_inertial(site: Site) -> str | None:
    """Remove <inertial> from a moving link."""
    link = site.choose(site.list_moving_links("inertial"))
    if link is None:
        return None
    link.remove(link.find("inertial"))
    return str(link.get("name"))


def list_shown_links(site: Site) -> list[Element]:
    """Return the moving links with visual and collision shapes."""
    links = site.list_moving_links("collision")
    return [link for link in links if link.find("visual") is not None]


def remove_collision(site: Site) -> str | None:
    """Remove the collision shapes of a moving link that has visual shapes."""
    link = site.choose(list_shown_links(site))
    if link is None:
        return None
    for shape in link.findall("collision"):
        link.remove(shape)
    return str(link.get("name"))


def displace_collision(site: Site) -> str | None:
    """Translate the collision shapes of a moving link by 1.5 times its size along x."""
    link = site.choose(list_shown_links(site))
    if link is None:
        return None
    for shape in link.findall("collision"):
        shift_origin(shape, 0, 1.5 * site.sizes.get(str(link.get("name")), 0.1))
    return str(link.get("name"))


def displace_com(site: Site) -> str | None:
    """Translate the CoM of a moving link by twice its size along z."""
    link = site.choose(site.list_moving_links("inertial"))
    if link is None:
        return None
    shift_origin(link.find("inertial"), 2, 2.0 * site.sizes.get(str(link.get("name")), 0.1))
    return str(link.get("name"))


def break_mesh_path(site: Site) -> str | None:
    """Append an extension to the path of a mesh."""
    shapes = [s for tag in ("visual", "collision") for s in site.root.findall(f"link/{tag}")]
    shape = site.choose([shape for shape in shapes if shape.find("geometry/mesh") is not None])
    if shape is None:
        return None
    mesh = shape.find("geometry/mesh")
    mesh.set("filename", f"{mesh.get('filename')}.missing")
    return str(shape.getparent().get("name"))


def displace_joint(site: Site) -> str | None:
    """Translate the origin of a joint into its parent, by 0.6 times the size of its child.

    A slide moves against its axis, a hinge along -x.
    """
    slides, hinges = site.list_joints("prismatic"), site.list_joints("revolute")
    joint = site.choose(slides or hinges)
    if joint is None:
        return None
    size = 0.6 * site.sizes.get(joint.find("child").get("link"), 0.1)
    axis = joint.find("axis")
    direction = np.array([1.0, 0.0, 0.0])
    if slides and axis is not None:
        direction = np.array(read_numbers(axis, "xyz"))
    for index in np.flatnonzero(direction).tolist():
        shift_origin(joint, index, -size * direction[index] / float(np.linalg.norm(direction)))
    return str(joint.get("name"))


@dataclass(frozen=True)
class Kind:
    """Kind of defect.

    Attributes:
        plant: Function that edits a copy, and returns the name of the edited link or joint ("" for
            the whole file); None if the robot has no such element.
        rules: Rules of the audit that name the cause.
        evidence: From which parts of the file the published value follows: ``"itself"`` (the edited
            value), ``"partner"`` (the link or joint of the other side), ``"limbs"`` (the partner
            and two more limbs, since nothing else decides which of two partners is wrong) or
            ``"shape"`` (an equal limb with the same visual shape, or the own visual mesh).
    """

    plant: Callable[[Site], str | None]
    rules: tuple[str, ...]
    evidence: str = "partner"


KINDS = {
    "lengths in mm": Kind(lambda site: scale_lengths(site, 1000.0), ("scale-unusual",), "itself"),
    "lengths in km": Kind(lambda site: scale_lengths(site, 1e-3), ("scale-unusual",), "itself"),
    "axis reversed": Kind(
        reverse_axis, ("mirror-axis", "mirror-limits", "limits-away-from-stand"), "limbs"
    ),
    "axis of zeros": Kind(clear_axis, ("axis-zero",)),
    "limits exchanged": Kind(exchange_limits, ("range-empty",), "itself"),
    "limits in degrees": Kind(write_limits_in_degrees, ("limits-in-wrong-unit",), "itself"),
    "inertia of zeros": Kind(edit_inertia(clear_tensor), ("inertia-not-positive-definite",)),
    "moment too large": Kind(edit_inertia(enlarge_moment), ("triangle-inequality",)),
    "moment negative": Kind(edit_inertia(negate_moment), ("inertia-not-positive-definite",)),
    "mass in g": Kind(write_grams, ("density-implausible", "mirror-mass", "mass-beyond-motors")),
    "mass of zero": Kind(clear_mass, ("mass-not-positive", "moving-body-without-mass")),
    "no inertial": Kind(remove_inertial, ("moving-body-without-mass", "link-without-inertial")),
    "no collision shape": Kind(
        remove_collision, ("mirror-shapes", "moving-link-without-collision"), "shape"
    ),
    "collision shape displaced": Kind(
        displace_collision, ("mirror-shapes", "shape-off-link", "collision-off-visual"), "shape"
    ),
    "CoM outside": Kind(displace_com, ("com-outside-shapes", "mirror-com")),
    "mesh path broken": Kind(break_mesh_path, ("mesh-missing",), "itself"),
    "joint displaced": Kind(displace_joint, ("mirror-position", "joint-off-links"), "limbs"),
}
"""{name of the kind: planting function and rules that name the cause}."""


def rename_everything(site: Site) -> None:
    """Write a prefix before the names of all links and joints."""
    for element in site.root.iter("link", "joint", "parent", "child", "mimic"):
        for word in ("name", "link", "joint"):
            if element.get(word) not in (None, "world"):
                element.set(word, f"robot_{element.get(word)}")


def turn_inertial_frames(site: Site) -> None:
    """Turn the frame of each inertial by a quarter turn about z, and its tensor with it."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for inertial in site.root.iterfind("link/inertial"):
        origin, inertia = inertial.find("origin"), inertial.find("inertia")
        if inertia is None or (origin is not None and any(read_numbers(origin, "rpy"))):
            continue
        if origin is None:
            origin = etree.Element("origin", xyz="0 0 0")
            inertial.insert(0, origin)
        origin.set("rpy", f"0 0 {math.pi / 2:.16g}")
        xx, xy, xz, yy, yz, zz = (float(inertia.get(word, 0)) for word in TENSOR)
        tensor = turn.T @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn
        for word, row, column in zip(TENSOR, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2), strict=True):
            inertia.set(word, repr(float(tensor[row, column])))


def write_fewer_digits(site: Site) -> None:
    """Round masses, CoMs and moments to five digits."""
    for inertial in site.root.iterfind("link/inertial"):
        for element in inertial.iterchildren(tag=etree.Element):
            for word, text in element.attrib.items():
                element.set(word, " ".join(f"{float(part):.5g}" for part in text.split()))


def exchange_frames_of_limits(site: Site) -> None:
    """Reverse the axes of hinges with a lower limit, and exchange their limits with the sign."""
    for joint in site.list_joints("revolute"):
        axis, limit = joint.find("axis"), joint.find("limit")
        if axis is None or limit is None or limit.get("lower") is None:
            continue
        write_numbers(axis, "xyz", [0.0 - value for value in read_numbers(axis, "xyz")])
        lower, upper = limit.get("lower"), limit.get("upper", "0")
        limit.set("lower", repr(0.0 - float(upper)))
        limit.set("upper", repr(0.0 - float(lower)))


def reorder_elements(site: Site) -> None:
    """Write links and joints in the reverse order."""
    children = list(site.root)
    for child in children:
        site.root.remove(child)
    site.root.extend(reversed(children))


def load_slightly(site: Site) -> None:
    """Multiply all masses and moments by 1.05: another battery or another print."""
    for element in site.root.iterfind("link/inertial/*"):
        for word in element.attrib if element.tag in ("mass", "inertia") else ():
            element.set(word, repr(1.05 * float(element.get(word))))


HARMLESS: dict[str, Callable[[Site], None]] = {
    "nothing": lambda _: None,
    "names with a prefix": rename_everything,
    "inertial frames turned": turn_inertial_frames,
    "five digits": write_fewer_digits,
    "axes and limits reversed": exchange_frames_of_limits,
    "reverse order": reorder_elements,
    "5 % heavier": load_slightly,
}
"""{edit: function}: edits after which the robot is as sound as before."""


def read_robot(path: Path, share: Path) -> UrdfModel:
    """Return the model of a URDF."""
    file = read_model(path, {PACKAGE: share})
    assert isinstance(file, UrdfFile)
    return read_urdf_model(file)


def read_sizes(path: Path, share: Path) -> dict[str, float]:
    """Return {link: largest extent of its shapes [m]} of the links with shapes of known size."""
    robot = read_robot(path, share)
    sizes = {}
    for name, link in robot.links.items():
        points = list_extent_points([link], link)
        if points is not None:
            sizes[name] = float(np.ptp(points, axis=0).max())
    return sizes


PACKAGE = "example-robot-data"
"""Name of the ROS package with most of the robots."""


def run_audit(path: Path, share: Path) -> Audit:
    """Return the errors and warnings of a file."""
    audit = pa.audit_model(path, packages={PACKAGE: share})
    return replace(audit, findings=tuple(f for f in audit.findings if f.severity != "note"))


def copy_root(path: Path) -> Element:
    """Return the root element of a URDF, with absolute paths of meshes."""
    root = etree.parse(str(path), etree.XMLParser(remove_comments=True)).getroot()
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if "://" not in name and not Path(name).is_absolute():
            mesh.set("filename", str((path.parent / name).resolve()))
    return root


def name_places(root: Element, name: str) -> set[str]:
    """Return the name of an edited link or joint, and of the joint or link that moves with it."""
    pairs = {
        joint.get("name"): joint.find("child").get("link")
        for joint in root.iter("joint")
        if joint.find("child") is not None
    }
    return {name} | {p for pair in pairs.items() for p in pair if name in pair and name}


def is_about(finding: Finding, places: set[str]) -> bool:
    """Return True if a finding names one of the places, as its element or in its message."""
    text = f"{finding.element} {finding.message}"
    return any(re.search(rf"(?<![\w-]){re.escape(place)}(?![\w-])", text) for place in places)


def is_unique(evidence: str, robot: UrdfModel, audit: Audit, places: set[str]) -> bool:
    """Return True if the published value follows from the file with the defect.

    Args:
        evidence: Kind of evidence that is needed, see `Kind`.
        robot: Published robot.
        audit: Audit of the published robot; a reported difference of sides is no evidence.
        places: Edited link and joint.
    """
    if evidence == "itself":
        return True
    names = [*robot.links, *robot.joints]
    kinds = {strip_sides(place) for place in places}
    limbs = [name for name in names if name not in places and strip_sides(name) in kinds]
    if evidence == "shape":
        trees = robot.file.tree.links
        own = [trees[place] for place in places if place in trees]
        return any(has_equal_shapes(own[0], trees[limb]) for limb in limbs if limb in trees)
    pairs = [*find_mirror_pairs(robot.links), *find_mirror_pairs(robot.joints)]
    has_partner = any(set(pair) & places for pair in pairs) and not any(
        finding.rule.startswith("mirror") and is_about(finding, places)
        for finding in audit.findings
    )
    return has_partner and (evidence == "partner" or len(limbs) >= 2 * MIN_LIMBS)


MIN_LIMBS = 3
"""Number of other limbs, the partner included, that decide which of two partners is wrong; each has
an equal link and an equal joint."""


def has_equal_shapes(first: UrdfLink, second: UrdfLink) -> bool:
    """Return True if two links have the same visual shapes, and each a single collision shape."""
    texts = [
        [
            re.sub(rb"\s+", b"", etree.tostring(shape, method="c14n"))
            for shape in link.element.iterfind("visual")
        ]
        for link in (first, second)
    ]
    single = all(len(link.element.findall("collision")) == 1 for link in (first, second))
    return single and texts[0] == texts[1]


def restores(audit: Audit, finding: Finding, published: Element) -> bool | None:
    """Return whether the single repair of a finding restores the published values within 2 %.

    None if the finding has no repair or several. The repair of all lengths is the factor that the
    message states.
    """
    factor = finding.diagnostic.values.get("factor")
    if factor is not None:
        repaired = etree.parse(finding.file).getroot()
        scale_lengths(Site(repaired, random.Random(), {}), float(factor))
        return equal_trees(repaired, published)
    if len(finding.repairs) != 1:
        return None
    documents, _ = apply_repairs([replace(audit, findings=(finding,))])
    mended = etree.fromstring(documents[0].render()) if documents else None
    return mended is not None and equal_trees(mended, published)


def equal_trees(first: Element, second: Element) -> bool:
    """Return True if two files state equal numbers, within 2 % of the largest of an attribute.

    Children are compared by tag and order. A missing <origin>, axis or scale has its default. The
    <material> of a <collision> is ignored: no reader of URDF evaluates it.
    """
    words = {*first.attrib, *second.attrib}
    for word in words:
        default = "1 1 1" if word == "scale" else "0 0 0" if word in ("xyz", "rpy") else "0"
        texts = [element.get(word, default).split() for element in (first, second)]
        try:
            one, other = (np.array([float(part) for part in text]) for text in texts)
        except ValueError:
            if texts[0] != texts[1]:
                return False
            continue
        size = max(np.abs(one).max(initial=0), np.abs(other).max(initial=0))
        if first.tag == "inertia":
            size = max(abs(float(second.get(each, 0))) for each in TENSOR)
        if len(one) != len(other) or np.abs(one - other).max(initial=0) > 0.02 * size:
            return False
    tags = {child.tag for element in (first, second) for child in element.iterchildren("*")}
    if first.tag == "collision":
        tags.discard("material")
    for tag in tags:
        children = [element.findall(tag) for element in (first, second)]
        if tag == "origin":
            children = [found or [etree.Element("origin")] for found in children]
        if len(children[0]) != len(children[1]):
            return False
        if not all(equal_trees(*pair) for pair in zip(*children, strict=True)):
            return False
    return True


@dataclass(frozen=True)
class Row:
    """Result for one planted defect.

    Attributes:
        robot: Name of the robot.
        kind: Kind of the defect.
        place: Name of the edited link or joint; "" for the whole file.
        found: Whether a new finding names the place.
        first: Whether the first new finding names the place and the cause.
        unique: Whether the published value follows from the file.
        remedy: Whether the repair restores the published values; None without a single repair.
        rule: Rule of the first new finding.
    """

    robot: str
    kind: str
    place: str
    found: bool
    first: bool
    unique: bool
    remedy: bool | None
    rule: str


def plant(
    robot: str, name: str, source: Path, share: Path, folder: Path, sound: Audit, seed: str
) -> Row | None:
    """Write a file with one defect, and judge its audit; None if the robot has no such element."""
    kind, published = KINDS[name], copy_root(source)
    root = copy_root(source)
    edited = kind.plant(Site(root, random.Random(seed), read_sizes(source, share)))
    if edited is None:
        return None
    path = folder / "robot.urdf"
    path.write_bytes(etree.tostring(root, pretty_print=True))
    known = Counter((f.rule, f.element) for f in sound.findings)
    audit = run_audit(path, share)
    fresh = [f for f in audit.findings if (f.rule, f.element) not in known]
    places = name_places(published, edited)
    found = any(not edited or is_about(finding, places) for finding in fresh)
    first = (
        bool(fresh) and fresh[0].rule in kind.rules and (not edited or is_about(fresh[0], places))
    )
    unique = is_unique(kind.evidence, read_robot(source, share), sound, places)
    remedy = restores(audit, fresh[0], published) if first else None
    return Row(robot, name, edited, found, first, unique, remedy, fresh[0].rule if fresh else "-")


def audit_sound(source: Path, share: Path, folder: Path) -> Audit:
    """Return the errors and warnings of the published file, written as the files with defects."""
    path = folder / "sound.urdf"
    path.write_bytes(etree.tostring(copy_root(source), pretty_print=True))
    return run_audit(path, share)


def count_alarms(
    source: Path, share: Path, folder: Path, sound: Audit
) -> list[tuple[str, str, str]]:
    """Return (edit, rule, element) of new findings after harmless edits."""
    known = Counter(f.rule for f in sound.findings)
    alarms = []
    for name, edit in HARMLESS.items():
        root = copy_root(source)
        edit(Site(root, random.Random(0), {}))
        path = folder / "harmless.urdf"
        path.write_bytes(etree.tostring(root, pretty_print=True))
        found = run_audit(path, share).findings
        fresh = Counter(f.rule for f in found) - known
        alarms += [(name, f.rule, f.element) for f in found if f.rule in fresh]
    return alarms


COLUMNS = (
    "kind", "planted", "found", "cause first", "value unique", "remedy proposed", "remedy right",
)  # fmt: skip
"""Columns of the table."""


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--seed", type=int, required=True)
@click.option("--count", type=int, default=300, show_default=True, help="Defects in all.")
@click.option("--only", multiple=True, type=click.Choice([*KINDS]), help="Repeatable.")
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the counts here.")
def main(robots: Path, seed: int, count: int, only: tuple[str, ...], to: Path | None) -> None:
    """Plant defects, one per file, and count causes, remedies and false alarms."""
    share = (robots / DATA).parent.resolve()
    rng = random.Random(seed)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for robot, file in ROBOTS.items():
            kinds = rng.sample([*KINDS], len(KINDS))
            sound = audit_sound(robots / file, share, folder)
            wanted = count * (1 + list(ROBOTS).index(robot)) // len(ROBOTS)
            attempt = 0
            while len(rows) < wanted and attempt < 10 * len(kinds):
                kind = kinds[attempt % len(kinds)]
                label = f"{seed} {robot} {attempt}"
                attempt += 1
                row = None
                if not only or kind in only:
                    row = plant(robot, kind, robots / file, share, folder, sound, label)
                if row is not None:
                    rows.append(row)
                    miss = not row.first or (row.unique and not row.remedy)
                    click.echo(
                        ("MISS " if miss else "     ")
                        + " | ".join(str(part) for part in vars(row).values()),
                        err=True,
                    )
            for alarm in count_alarms(robots / file, share, folder, sound):
                click.echo(f"ALARM {robot} " + " | ".join(alarm), err=True)
    table = []
    for kind in [*KINDS, "all"]:
        of = [row for row in rows if kind in (row.kind, "all")]
        table.append(
            (
                kind,
                len(of),
                sum(row.found for row in of),
                sum(row.first for row in of),
                sum(row.unique for row in of),
                sum(row.unique and row.remedy is not None for row in of),
                sum(row.unique and bool(row.remedy) for row in of),
            )
        )
        click.echo(" | ".join(map(str, table[-1])))
    if to is not None:
        write_csv(to, COLUMNS, table)


if __name__ == "__main__":
    main()
