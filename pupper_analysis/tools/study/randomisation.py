"""Spreads of numbers, written for the domain randomisation of those who train policies."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import RANGES
from pupper_analysis.tools.study.parameters import AXES, Named

Form = Literal["yaml", "mjlab", "isaaclab"]

_DIGITS = 12
"""Significant digits: what is beyond is rounding, as in 0.39999999999999997."""

_HALF_RANGE = math.sqrt(3.0)
"""Half of a uniform range with a standard deviation of 1."""


@dataclass(frozen=True)
class RandomisationTerm:
    """An event term of a training framework.

    Attributes:
        function: Its name.
        params: {argument: its value, as Python writes it}.
        about: What else there is to say of it.
    """

    function: str
    params: dict[str, str]
    about: str = ""


def write_randomisation(
    spreads: Mapping[str, Mapping[str, Any]],
    path: str | Path,
    form: Form = "yaml",
    *,
    force: bool = False,
) -> tuple[str, ...]:
    """Writes spreads for the domain randomisation of those who train policies.

    As YAML each entry has the number, how it acts (``scale`` on the model's value, ``add`` to it,
    or ``absolute``), the distribution, and its numbers. ``mjlab`` and ``isaaclab`` write a Python
    file with event terms of these frameworks, ``EventTermCfg``, by their names and arguments
    (mjlab 1.6, Isaac Lab 2). Of a normal distribution, where a term takes a range alone, that is
    the uniform one of the same deviation.

    Args:
        spreads: {variable: {kind: numbers}}, as ``Tolerance.spreads`` or ``Study.spreads``.
            ``KIND:each:PATTERN`` is drawn for each that matches, ``KIND:PATTERN`` once for all.
        path: The file.
        form: ``yaml``, ``mjlab`` or ``isaaclab``.
        force: Replace what is no such file, too.

    Returns:
        The variables for which the framework has no term: they are named in the file, and not
        randomised by it.

    Raises:
        ConfigurationError: If a spread is none, or there is no such form.
        OutputError: If it cannot be written, or is no such file.
    """
    check_type("path", path, str | Path)
    text, left = randomisation_text(spreads, form)
    with whole_file(Path(path), RANGES, force=force) as file:
        file.write(text.encode())
    return left


def randomisation_text(
    spreads: Mapping[str, Mapping[str, Any]], form: Form
) -> tuple[str, tuple[str, ...]]:
    """Returns what ``write_randomisation`` writes, and what it returns.

    Raises:
        ConfigurationError: If a spread is none, or there is no such form.
    """
    check_type("spreads", spreads, Mapping[str, Mapping[str, Any]])
    if form not in ("yaml", *_FRAMEWORKS):
        told = diagnose("none-of", value=form, known=("yaml", *_FRAMEWORKS))
        raise ConfigurationError("form", told)
    for name, given in spreads.items():
        if not isinstance(given, Mapping) or len(given) != 1:
            told = diagnose("no-spread", name=name, given=repr(given))
            raise ConfigurationError("spreads", told)
    left: tuple[str, ...] = ()
    if form == "yaml":
        lines = list(_yaml(spreads))
    else:
        lines, left = _terms(spreads, form)
    return "\n".join(lines) + "\n", left


def _yaml(spreads: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    yield "# Domain randomization. scale: a factor on the model's value; add: to it; absolute: it."
    for name, given in spreads.items():
        ((kind, numbers),) = given.items()
        keys = {"normal": ("mean", "std"), "values": (), "linspace": ("low", "high", "count")}
        named = keys.get(kind, ("low", "high"))
        acts = "scale" if ":" in name or name.endswith("_scale") else "absolute"
        acts = "add" if name.partition(":")[0] in AXES else acts
        yield f'- name: "{name}"'
        yield f"  operation: {acts}"
        if ":" in name:
            yield f"  drawn: {'for each' if _each(name) else 'once'}"
        yield f"  distribution: {kind}"
        if not named:
            yield f"  values: [{', '.join(map(_short, numbers))}]"
        for key, value in zip(named, numbers, strict=False):
            yield f"  {key}: {_short(value)}"


def _terms(
    spreads: Mapping[str, Mapping[str, Any]], form: str
) -> tuple[list[str], tuple[str, ...]]:
    """Returns the lines of a Python file with event terms, and for what there is none."""
    module, imports, make = _FRAMEWORKS[form]
    lines = [
        f'"""Domain randomization, for {module}. "robot" is the entity\'s name."""',
        "",
        *imports,
    ]
    lines += ["", "EVENTS = {"]
    left = []
    for name, given in spreads.items():
        ((kind, numbers),) = given.items()
        term = make(name, kind, tuple(float(value) for value in numbers))
        if term is None:
            left.append(name)
            continue
        lines += [f"    # {name}: {kind} {', '.join(map(_short, numbers))}{term.about}"]
        lines += [f"    {name!r}: EventTermCfg(", f"        func={term.function},"]
        lines += ['        mode="startup",', "        params={"]
        lines += [f'            "{key}": {value},' for key, value in term.params.items()]
        lines += ["        },", "    ),"]
    lines += ["}"]
    if left:
        lines += ["", f"# {module} has no term for these, which stay as the model has them:"]
        lines += [f"#   {name}" for name in left]
    return lines, tuple(left)


def _range(kind: str, numbers: tuple[float, ...], *, gaussian: bool) -> tuple[str, str, str]:
    """Returns a term's range, its distribution, and what is to be said of it."""
    if kind == "normal" and gaussian:
        return _pair(*numbers), '"gaussian"', ": mean and standard deviation"
    if kind == "normal":
        mean, spread = numbers
        wide = _HALF_RANGE * spread
        return _pair(mean - wide, mean + wide), '"uniform"', ", as the range of that deviation"
    low, high = (min(numbers), max(numbers)) if kind == "values" else numbers[:2]
    return _pair(low, high), '"log_uniform"' if kind == "log_uniform" else '"uniform"', ""


def _mjlab(name: str, kind: str, numbers: tuple[float, ...]) -> RandomisationTerm | None:
    """Returns the term of mjlab's ``dr`` for a number."""
    named = Named.of(name)
    if name in ("payload", "friction"):
        span, drawn, about = _range(kind, numbers, gaussian=True)
        function, operation = (
            ("body_mass", "add") if name == "payload" else ("geom_friction", "abs")
        )
        which = 'body_names=("BASE",)' if name == "payload" else 'geom_names=("FEET",)'
        told = f"{about}; put in the names of your {'base' if name == 'payload' else 'feet'}"
        return RandomisationTerm(
            f"dr.{function}", _dr(which, "ranges", span, operation, drawn), told
        )
    if named is None or named.kind not in _DR:
        return None
    function, argument, entity = _DR[named.kind]
    span, drawn, about = _range(kind, numbers, gaussian=argument == "ranges")
    params = _dr(
        f"{entity}=({_regex(named.pattern)!r},)",
        argument,
        span,
        "add" if named.kind in AXES else "scale",
        drawn,
    )
    if named.kind in AXES:
        params["axes"] = f"[{AXES.index(named.kind)}]"
    if function == "body_mass":
        about += "; of the mass alone, where the study's factor is on the inertia too"
    if argument == "ranges":  # mjlab draws for each that matches, if it is not told otherwise
        params["shared_random"] = str(not named.each)
    elif not named.each and not _one(named.pattern):
        about += _ALONE
    if function == "pd_gains":  # of the gain that does not vary, the model's own
        params |= {other: "(1.0, 1.0)" for other in ("kp_range", "kd_range") if other != argument}
    return RandomisationTerm(f"dr.{function}", params, about)


_DR = {
    **dict.fromkeys(AXES, ("body_com_offset", "ranges", "body_names")),
    "mass": ("body_mass", "ranges", "body_names"),
    "effort": ("effort_limits", "effort_limit_range", "actuator_names"),
    "kp": ("pd_gains", "kp_range", "actuator_names"),
    "kd": ("pd_gains", "kd_range", "actuator_names"),
    "armature": ("joint_armature", "ranges", "joint_names"),
    "damping": ("joint_damping", "ranges", "joint_names"),
    "frictionloss": ("joint_friction", "ranges", "joint_names"),
}
"""{kind of a factor: (function of ``mjlab.envs.mdp.dr``, its range, what names are of)}."""


def _dr(which: str, argument: str, span: str, operation: str, drawn: str) -> dict[str, str]:
    return {
        "asset_cfg": f'SceneEntityCfg("robot", {which})',
        argument: span,
        "operation": f'"{operation}"',
        "distribution": drawn,
    }


def _isaaclab(name: str, kind: str, numbers: tuple[float, ...]) -> RandomisationTerm | None:
    """Returns the event term of Isaac Lab for a number."""
    span, drawn, about = _range(kind, numbers, gaussian=True)
    named = Named.of(name)
    robot = 'SceneEntityCfg("robot", {which})'
    if name == "friction":
        span, _, about = _range(kind, numbers, gaussian=False)
        which = robot.format(which='body_names=["FEET"]')
        params = {"asset_cfg": which, "static_friction_range": span}
        params |= {"dynamic_friction_range": span, "restitution_range": "(0.0, 0.0)"}
        params |= {"num_buckets": "64", "make_consistent": "True"}
        return RandomisationTerm(
            "mdp.randomize_rigid_body_material", params, f"{about}; put in your feet's names"
        )
    if name in ("kp", "kd"):
        which, argument, operation = 'joint_names=[".*"]', _ISAAC[name][1], "abs"
        function = _ISAAC[name][0]
    elif name == "payload":
        which, argument, operation = 'body_names=["BASE"]', "mass_distribution_params", "add"
        function, about = "randomize_rigid_body_mass", f"{about}; put in the name of your base"
    elif named is not None and named.kind in AXES:
        span, _, about = _range(kind, numbers, gaussian=False)
        which = robot.format(which=f"body_names=[{_regex(named.pattern)!r}]")
        if named.each:
            about += "; drawn once for all that match, where the study has one for each"
        params = {"asset_cfg": which, "com_range": f'{{"{named.kind[-1]}": {span}}}'}
        return RandomisationTerm("mdp.randomize_rigid_body_com", params, about)
    elif named is not None and named.kind in _ISAAC:
        function, argument, entity = _ISAAC[named.kind]
        which, operation = f"{entity}=[{_regex(named.pattern)!r}]", "scale"
        if not named.each and not _one(named.pattern):
            about += _ALONE
    else:
        return None
    params = {"asset_cfg": robot.format(which=which), argument: span}
    params |= {"operation": f'"{operation}"', "distribution": drawn}
    return RandomisationTerm(f"mdp.{function}", params, about)


_ISAAC = {
    "mass": ("randomize_rigid_body_mass", "mass_distribution_params", "body_names"),
    "kp": ("randomize_actuator_gains", "stiffness_distribution_params", "joint_names"),
    "kd": ("randomize_actuator_gains", "damping_distribution_params", "joint_names"),
    "armature": ("randomize_joint_parameters", "armature_distribution_params", "joint_names"),
    "frictionloss": ("randomize_joint_parameters", "friction_distribution_params", "joint_names"),
}
"""{kind of a factor: (function of ``isaaclab.envs.mdp``, its range, what names are of)}."""

_FRAMEWORKS: Mapping[
    str,
    tuple[str, tuple[str, ...], Callable[[str, str, tuple[float, ...]], RandomisationTerm | None]],
] = {
    "mjlab": (
        "mjlab",
        (
            "from mjlab.envs.mdp import dr",
            "from mjlab.managers.event_manager import EventTermCfg",
            "from mjlab.managers.scene_entity_config import SceneEntityCfg",
        ),
        _mjlab,
    ),
    "isaaclab": (
        "Isaac Lab",
        (
            "import isaaclab.envs.mdp as mdp",
            "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        ),
        _isaaclab,
    ),
}


_ALONE = "; drawn for each that matches, where the study's factor is one for all"


def _each(name: str) -> bool:
    named = Named.of(name)
    return named is not None and named.each


def _one(pattern: str) -> bool:
    """Whether a pattern is a plain name."""
    return not set(pattern) & set("*?[")


def _regex(pattern: str) -> str:
    """Returns the regular expression of a pattern of file names, which both frameworks match."""
    parts = re.split(r"(\[.[^]]*\]|[*?])", pattern)
    known = {"*": ".*", "?": "."}
    return "".join(
        f"[{'^' * (part[1] == '!')}{part[1 + (part[1] == '!') :]}"
        if part.startswith("[") and part.endswith("]")
        else known.get(part, re.escape(part))
        for part in parts
    )


def _pair(low: float, high: float) -> str:
    return f"({_short(low)}, {_short(high)})"


def _short(value: Any) -> str:
    """Returns a number without the digits of rounding."""
    return repr(float(f"{float(value):.{_DIGITS}g}"))
