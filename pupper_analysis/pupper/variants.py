"""Base models of the package, and the variants derived from them.

A ``VariantSpec`` contains the name of a base model and two scale factors: of the legs, and of the
torso mass. ``VARIANTS`` lists the variants with names. The files are derived by `derive` and
`variant_files`.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, VariantError

_MAX_NAME_BYTES = 200
"""Upper bound of the length of a variant's name [bytes]. Chosen, not tuned: many file systems
permit 255, including suffixes.
"""


@dataclass(frozen=True)
class BaseModel:
    """Pair of model files from which variants are derived.

    Attributes:
        urdf: Name of the file in ``urdf/``.
        mjcf: Name of the file in ``mjcf/``.
        feet: {foot: name of the URDF link and of the MJCF site}.
        foot_depth: Function from ``leg_scale`` to the depth of the feet below the hips in the
            nominal stand [m].
        ballast: Centre and size of the dark block that marks a heavier torso, shape (2, 3) [m], in
            the frame of the base. The block is drawn only, without mass and contacts.
        remarks: Function that returns notes for users.
    """

    urdf: str
    mjcf: str
    feet: Mapping[str, str]
    foot_depth: Callable[[float], float]
    ballast: tuple[tuple[float, float, float], tuple[float, float, float]]
    remarks: Callable[[], tuple[Diagnostic, ...]] = tuple


BASE_MODELS: Mapping[str, BaseModel] = MappingProxyType(
    {
        "skeleton": BaseModel(
            urdf="pupper_skeleton.urdf",
            mjcf="pupper_skeleton.xml",
            feet={leg: f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")},
            foot_depth=lambda leg_scale: 0.14 * min(leg_scale, 1.5),
            ballast=((0.01, 0.0, 0.06), (0.1, 0.07, 0.03)),
        ),
        "v3": BaseModel(
            urdf="pupper_v3.urdf",
            mjcf="pupper_v3.xml",
            feet={
                "FR": "leg_front_r_3_foot_site",
                "FL": "leg_front_l_3_foot_site",
                "RR": "leg_back_r_3_foot_site",
                "RL": "leg_back_l_3_foot_site",
            },
            foot_depth=lambda leg_scale: 0.11156 * leg_scale,
            ballast=((-0.01, 0.0, 0.079), (0.07, 0.084, 0.024)),
            remarks=lambda: (diagnose("first-joints-pitch"),),
        ),
    }
)
"""{name: base model}; variants are base models with scaled legs and torso mass."""


def _check_name(name: object) -> None:
    """Raise VariantError if the name of a variant is not permitted as a file name.

    An empty name is accepted.
    """
    if not isinstance(name, str):
        raise VariantError("name", name, diagnose("name-is-no-text"))
    if name.startswith(".") or set(name) & set("/\\:") or not name.isprintable():
        raise VariantError("name", name, diagnose("name-of-no-file"))
    if len(name.encode()) > _MAX_NAME_BYTES:
        raise VariantError("name", name, diagnose("name-too-long", most=_MAX_NAME_BYTES))


@dataclass(frozen=True)
class VariantSpec:
    """Robot derived from a base model by scaling.

    Attributes:
        base: ``"skeleton"`` or ``"v3"``.
        leg_scale: Factor of the length of each thigh and calf, whose masses change accordingly;
            > 0, at most `MAX_SCALE`.
        torso_mass_scale: Factor of the mass and inertia of the torso; > 0, at most `MAX_SCALE`.
        name: Name for tables and files; by default formed from the other values.

    Raises:
        VariantError: If the base is unknown, a scale is not positive, not finite or above
            `MAX_SCALE`, or the name is no valid file name.
    """

    base: str = "skeleton"
    leg_scale: float = 1.0
    torso_mass_scale: float = 1.0
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.base, str) or self.base not in BASE_MODELS:
            raise VariantError("base", self.base, diagnose("valid-bases", bases=BASE_MODELS))
        for scale_name in ("leg_scale", "torso_mass_scale"):
            value = getattr(self, scale_name)
            try:
                number = check_finite(scale_name, value)
            except ConfigurationError:
                number = 0.0
            if number <= 0:
                raise VariantError(scale_name, value, diagnose("scale-not-positive"))
            if number > MAX_SCALE:
                raise VariantError(scale_name, value, diagnose("scale-too-large", most=MAX_SCALE))
            object.__setattr__(self, scale_name, number)
        _check_name(self.name)
        if not self.name:
            default_name = f"{self.base}-leg{self.leg_scale:g}-torso{self.torso_mass_scale:g}"
            object.__setattr__(self, "name", default_name)


MAX_SCALE = 1000.0
"""Upper bound of ``leg_scale`` and ``torso_mass_scale`` [1]. Chosen, not tuned."""

VARIANTS: Mapping[str, VariantSpec] = MappingProxyType(
    {
        name: VariantSpec(base, leg_scale, torso_mass_scale, name)
        for name, base, leg_scale, torso_mass_scale in (
            ("original", "skeleton", 1.0, 1.0),
            ("long-leg", "skeleton", 1.5, 1.0),
            ("heavy", "skeleton", 1.0, 2.0),
            ("v3", "v3", 1.0, 1.0),
            ("v3-long-leg", "v3", 1.5, 1.0),
            ("v3-heavy", "v3", 1.0, 2.0),
        )
    }
)
"""{name: specification} of the predefined variants of the robot Pupper."""


def get_variant_spec(variant: str | VariantSpec) -> VariantSpec:
    """Return the spec of a variant by name; a spec is returned unchanged.

    Raises:
        VariantError: If the name is unknown.
    """
    if isinstance(variant, VariantSpec):
        return variant
    if not isinstance(variant, str) or variant not in VARIANTS:
        similar = list_similar_variants(variant) if isinstance(variant, str) else []
        problem = diagnose("known-variants", alike=similar, variants=VARIANTS)
        raise VariantError("name", variant, problem)
    return VARIANTS[variant]


def list_similar_variants(word: str) -> list[str]:
    """Return the names of up to three variants that are similar to a word, the most similar first.

    A name that differs only in a number, as v3 from v4, is the most similar. Upper and lower case
    are not distinguished.
    """
    name = word.lower()
    renumbered = [
        variant
        for variant in VARIANTS
        if _NUMBER.search(name) and _NUMBER.sub("0", variant) == _NUMBER.sub("0", name)
    ]
    similar = difflib.get_close_matches(name, VARIANTS)
    return list(dict.fromkeys((*renumbered, *similar)))[:_MAX_SIMILAR_VARIANTS]


_NUMBER = re.compile(r"\d+")
"""Pattern of a number in the name of a variant."""

_MAX_SIMILAR_VARIANTS = 3
"""Largest number of names that `list_similar_variants` returns. Chosen, not tuned."""


@cache
def find_model_folder(kind: str) -> Path:
    """Return the folder of the package's model files.

    In an installed wheel, the folders are part of the package. In a checkout, the folders are at
    the top level.

    Args:
        kind: ``"urdf"`` or ``"mjcf"``.

    Raises:
        ModelError: If the folder exists in neither place.
    """
    here = Path(__file__).resolve().parent
    for folder in (here / kind, here.parents[1] / kind):
        if folder.is_dir():
            return folder
    raise ModelError(here, diagnose("package-folder-missing", kind=kind))


@dataclass(frozen=True)
class ScalableVariant:
    """Variant whose scale factors a study changes.

    Attributes:
        spec: Variant with the default scales.
    """

    spec: VariantSpec

    @property
    def scales(self) -> Mapping[str, float]:
        """{``leg_scale`` or ``torso_mass_scale``: scale factor [1]}, for legs and torso mass."""
        return {name: getattr(self.spec, name) for name in ("leg_scale", "torso_mass_scale")}

    def with_scales(self, scales: Mapping[str, float]) -> VariantSpec:
        """Return a variant with some scale factors replaced, and the default name.

        Args:
            scales: {``leg_scale`` or ``torso_mass_scale``: factor}; a missing factor stays
                unchanged.

        Raises:
            VariantError: If a scale is not a finite positive number, or too large.
        """
        merged = {**self.scales, **scales}
        return VariantSpec(self.spec.base, merged["leg_scale"], merged["torso_mass_scale"])
