"""Malformed model files."""

from __future__ import annotations

INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)
"""``<inertial>`` of a link."""

LIMIT = '<limit lower="-1" upper="1" effort="2" velocity="3"/>'
"""``<limit>`` of a joint."""


def format_link(name: str, content: str = INERTIAL) -> str:
    """Return the ``<link>`` of a URDF."""
    return f'<link name="{name}">{content}</link>'


def format_joint(
    name: str, parent: str, child: str, content: str = LIMIT, kind: str = "revolute"
) -> str:
    """Return the ``<joint>`` of a URDF."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{content}</joint>'


def format_urdf(*lines: str) -> str:
    """Return a URDF with an element per line; the first element is in line 2."""
    return "\n".join(['<robot name="r">', *lines, "</robot>"])


def format_mjcf(*lines: str) -> str:
    """Return an MJCF with an element per line; the first element is in line 2."""
    return "\n".join(['<mujoco model="m">', *lines, "</mujoco>"])


def _format_two_links(content: str, kind: str = "revolute") -> str:
    """Return a URDF of two links and a joint."""
    return format_urdf(
        format_link("a"), format_link("b"), format_joint("j", "a", "b", content, kind)
    )


def _format_entity_bomb() -> str:
    """Return a URDF whose nested entities would expand to 10^29 words."""
    entities = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 30))
    return f'<!DOCTYPE robot [<!ENTITY l0 "lol">{entities}]>\n<robot name="&l29;"/>'


_CHAIN = [
    part
    for i in range(300)
    for part in (format_link(f"l{i + 1}"), format_joint(f"j{i}", f"l{i}", f"l{i + 1}"))
]

# What to write into the file; the line in the message (None: none); what the message says.
MALFORMED: dict[str, tuple[str | bytes, int | None, str]] = {
    "empty": ("", None, "the file is empty"),
    "blank": (" \n\n", None, "the file is empty"),
    "binary": (b"<robot>\n\x00\x01", 2, "not a text file"),
    "latin-1": ('<robot name="r">\n\xe9</robot>'.encode("latin-1"), 2, "0xe9 is not UTF-8"),
    "utf-16": ("<robot/>".encode("utf-16"), None, "UTF-16"),
    "no XML": ("solid cube\n", 1, "not well-formed"),
    "truncated": ('<robot name="r">\n<link name="a">', 2, "not well-formed"),
    "unknown entity": ('<robot name="r">\n&lol;</robot>', 2, "not well-formed"),
    "billion laughs": (_format_entity_bomb(), 1, "DOCTYPE"),
    "external entity": (
        '<?xml version="1.0"?>\n<!-- x -->\n<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
        '\n<robot name="&x;"/>',
        3,
        "DOCTYPE",
    ),
    "too large": (b"<robot>" + b" " * 20_000_000, None, "more than 20 MB"),
    "too deep": ("<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>", 1, "deeper than 250"),
    "too many elements": (format_urdf("<a/>" * 30_001), None, "the maximum is 30000"),
    "other root": ("<html/>", 1, "the root element is <html>"),
    "part": ("<mujocoinclude/>", 1, "give the file that includes it"),
    "xacro": (
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">\n<xacro:include/></robot>',
        2,
        "give the expanded URDF",
    ),
    "xacro undeclared": ('<robot name="r">\n<xacro:include/></robot>', 2, "give the expanded URDF"),
    "undeclared prefix": ('<robot name="r">\n<a:b/></robot>', 2, "prefix a on b is not defined"),
    "xacro value": (_format_two_links('<limit effort="${e}" velocity="1"/>'), 4, "is xacro"),
    "no robot name": ("<robot><link name='a'/></robot>", 1, "the robot has no name"),
    "version": ('<robot name="r" version="2"><link name="a"/></robot>', 1, "valid: 1.0"),
    "no links": (format_urdf(), None, "no <link>"),
    "link without name": (format_urdf("<link/>"), 2, "the link has no name"),
    "link twice": (
        format_urdf(format_link("a"), format_link("a")),
        3,
        "'a' exists already (line 2)",
    ),
    "joint twice": (
        format_urdf(
            format_link("a"),
            format_link("b"),
            format_link("c"),
            format_joint("j", "a", "b"),
            format_joint("j", "b", "c"),
        ),
        6,
        "'j' exists already",
    ),
    "material twice": (
        format_urdf('<material name="m"/>', '<material name="m"/>'),
        3,
        "'m' exists already",
    ),
    "unknown parent": (
        format_urdf(format_link("a"), format_joint("j", "x", "a")),
        3,
        "parent 'x' is not a link",
    ),
    "unknown child": (
        format_urdf(format_link("a"), format_joint("j", "a", "x")),
        3,
        "child 'x' is not a link",
    ),
    "no parent": (
        format_urdf(format_link("a"), '<joint name="j" type="fixed"><child link="a"/></joint>'),
        3,
        "has no <parent>",
    ),
    "child without link": (
        format_urdf(
            format_link("a"), '<joint name="j" type="fixed"><parent link="a"/><child/></joint>'
        ),
        3,
        "<child> has no link",
    ),
    "two roots": (format_urdf(format_link("a"), format_link("b")), 3, "2 links have no parent"),
    "loop": (
        format_urdf(
            format_link("a"),
            format_link("b"),
            format_link("c"),
            format_joint("j", "b", "c"),
            format_joint("k", "c", "b"),
        ),
        6,
        "closes a loop",
    ),
    "joint to itself": (
        format_urdf(format_link("a"), format_joint("j", "a", "a")),
        3,
        "closes a loop",
    ),
    "two parents": (
        format_urdf(
            format_link("a"),
            format_link("b"),
            format_link("c"),
            format_joint("j", "a", "c"),
            format_joint("k", "b", "c"),
        ),
        6,
        "the child of two joints, 'j', 'k'",
    ),
    "long chain": (format_urdf(format_link("l0"), *_CHAIN), 503, "more than 250 joints"),
    "many links": (
        format_urdf(*(format_link(f"l{i}") for i in range(2001))),
        None,
        "the maximum is 2000",
    ),
    "unknown type": (_format_two_links(LIMIT, "hinge"), 4, "'hinge'; valid: revolute"),
    "no type": (
        format_urdf(
            format_link("a"), '<joint name="j"><parent link="a"/><child link="a"/></joint>'
        ),
        3,
        "no type",
    ),
    "no limit": (_format_two_links(""), 4, "without a <limit>"),
    "limit twice": (_format_two_links(LIMIT + LIMIT), 4, "more than once"),
    "empty dynamics": (_format_two_links(LIMIT + "<dynamics/>"), 4, "neither damping nor friction"),
    "two coordinates": (
        _format_two_links('<origin xyz="0 0"/>', "fixed"),
        4,
        "has 2 values; 3 are required",
    ),
    "no number": (_format_two_links('<origin xyz=""/>', "fixed"), 4, "has 0 values"),
    "nan": (
        _format_two_links('<origin xyz="0 nan 0"/>', "fixed"),
        4,
        "'nan' is not a finite number",
    ),
    "inf": (
        _format_two_links('<limit effort="inf" velocity="1"/>'),
        4,
        "'inf' is not a finite number",
    ),
    "overflow": (
        _format_two_links('<limit effort="1e999" velocity="1"/>'),
        4,
        "not a finite number",
    ),
    "text": (
        _format_two_links('<limit effort="big" velocity="1"/>'),
        4,
        "'big' is not a finite number",
    ),
    "underscore": (
        _format_two_links('<limit effort="1_0" velocity="1"/>'),
        4,
        "not a finite number",
    ),
    "unicode digit": (
        _format_two_links('<limit effort="\u0663" velocity="1"/>'),
        4,
        "not a finite number",
    ),
    "no mass": (
        format_urdf(format_link("a", "<inertial><inertia/></inertial>")),
        2,
        "<inertial> has no <mass>",
    ),
    "no ixy": (
        format_urdf(format_link("a", '<inertial><mass value="1"/><inertia ixx="1"/></inertial>')),
        2,
        "<inertia> has no ixy",
    ),
    "no geometry": (
        format_urdf(format_link("a", "<collision/>")),
        2,
        "<collision> has no <geometry>",
    ),
    "no radius": (
        format_urdf(format_link("a", "<visual><geometry><sphere/></geometry></visual>")),
        2,
        "<sphere> has no radius",
    ),
    "mjcf unknown element": (format_mjcf("<foo/>"), 2, "unrecognized element"),
    "mjcf missing include": (format_mjcf('<include file="x.xml"/>'), 2, "no such file"),
    "mjcf include without file": (format_mjcf("<include/>"), 2, "has no file"),
    "mjcf includes itself": (format_mjcf('<include file="model.xml"/>'), 2, "includes itself"),
    # MuJoCo 4.0 ends with a stack overflow.
    "mjcf attaches itself": (
        format_mjcf('<asset><model name="m" file="model.xml"/></asset>'),
        2,
        "attaches itself",
    ),
    "mjcf attaches nothing": (
        format_mjcf('<asset><model file="x.xml"/></asset>'),
        2,
        "no such file",
    ),
    # Hours, or all the memory.
    "mjcf replicate": (
        format_mjcf('<worldbody><replicate count="1000000000"><site/></replicate></worldbody>'),
        None,
        "more than 10000 elements",
    ),
    "mjcf nested replicates": (
        format_mjcf(
            "<worldbody>", '<replicate count="99">' * 9, "</replicate>" * 9, "</worldbody>"
        ),
        None,
        "more than 10000 elements",
    ),
    "mjcf texture": (
        format_mjcf(
            '<asset><texture name="t" builtin="flat" width="99999" height="99999"/></asset>'
        ),
        2,
        "width x height is too large",
    ),
    "mjcf hfield": (
        format_mjcf('<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>'),
        2,
        "nrow x ncol is too large",
    ),
    "mjcf hfield of a hexadecimal size": (
        format_mjcf(
            f'<asset><hfield name="h" nrow="0x{"f" * 300}" ncol="2" size="1 1 1 1"/></asset>'
        ),
        2,
        "nrow x ncol is too large",
    ),
    "mjcf keys": (format_mjcf('<size nkey="2000000000"/>'), 2, "nkey is too large"),
    "mjcf supersphere": (
        format_mjcf('<asset><mesh name="s" builtin="supersphere" params="99999 1 1"/></asset>'),
        2,
        "params is too large",
    ),
    "mjcf flexcomp": (format_mjcf('<flexcomp count="999 999 999"/>'), 2, "count is too large"),
}
"""{name: (content of the file, line number in the message or None, text in the message)}."""
