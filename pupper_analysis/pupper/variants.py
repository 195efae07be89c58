"""Which robot: the base models that come with the package, and the variants derived from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType

from pupper_analysis.base.arguments import check_finite
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, VariantError

_LONGEST_NAME = 200
"""Bytes: file systems allow 255, of which prefixes and suffixes take some."""


@dataclass(frozen=True)
class BaseModel:
    """A pair of model files from which variants are derived.

    Attributes:
        urdf: Name of the file in ``urdf/``.
        mjcf: Name of the file in ``mjcf/``.
        feet: For each foot, the name that both its URDF link and its MJCF site have.
        foot_depth: How far below the hips the nominal stand has its feet (m), by leg_scale.
        remarks: Returns what its users should know.
    """

    urdf: str
    mjcf: str
    feet: Mapping[str, str]
    foot_depth: Callable[[float], float]
    remarks: Callable[[], tuple[Diagnostic, ...]] = tuple


BASE_MODELS: Mapping[str, BaseModel] = MappingProxyType(
    {
        "skeleton": BaseModel(
            urdf="pupper_skeleton.urdf",
            mjcf="pupper_skeleton.xml",
            feet={leg: f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")},
            foot_depth=lambda leg_scale: 0.14 * min(leg_scale, 1.5),
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
            remarks=lambda: (diagnose("first-joints-pitch"),),
        ),
    }
)


def _check_name(name: object) -> None:
    """Refuses a name that is no file's, as it would be written into other folders."""
    if not isinstance(name, str):
        raise VariantError("name", name, diagnose("name-is-no-text"))
    if name.startswith(".") or set(name) & set("/\\:") or not name.isprintable():
        raise VariantError("name", name, diagnose("name-of-no-file"))
    if len(name.encode()) > _LONGEST_NAME:
        raise VariantError("name", name, diagnose("name-too-long", most=_LONGEST_NAME))


@dataclass(frozen=True)
class VariantSpec:
    """A robot derived from a base model by scaling.

    Attributes:
        base: ``"skeleton"`` or ``"v3"``.
        leg_scale: Factor on the length and on the mass of every thigh and calf; finite, > 0.
        torso_mass_scale: Factor on the mass and inertia of the torso; finite, > 0.
        name: A name for tables and files; made from the values where it is not given.

    Raises:
        VariantError: If the base is unknown, or a scale is not a finite positive number, or the
            name cannot be that of a file.
    """

    base: str = "skeleton"
    leg_scale: float = 1.0
    torso_mass_scale: float = 1.0
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.base, str) or self.base not in BASE_MODELS:
            raise VariantError("base", self.base, diagnose("valid-bases", bases=BASE_MODELS))
        for what in ("leg_scale", "torso_mass_scale"):
            value = getattr(self, what)
            try:
                number = check_finite(what, value)
            except ConfigurationError:
                number = 0.0
            if number <= 0:
                raise VariantError(what, value, diagnose("scale-not-positive"))
            if number > MAX_SCALE:
                raise VariantError(what, value, diagnose("scale-too-large", most=MAX_SCALE))
            object.__setattr__(self, what, number)
        _check_name(self.name)
        if not self.name:
            made = f"{self.base}-leg{self.leg_scale:g}-torso{self.torso_mass_scale:g}"
            object.__setattr__(self, "name", made)


MAX_SCALE = 1000.0
"""Legs of 100 m, a torso of a tonne: beyond, engines compute nonsense, and nobody builds it."""

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


def get_variant_spec(variant: str | VariantSpec) -> VariantSpec:
    """Returns the spec of a variant given by name; a spec is returned as it is.

    Raises:
        VariantError: If the name is unknown.
    """
    if isinstance(variant, VariantSpec):
        return variant
    if not isinstance(variant, str) or variant not in VARIANTS:
        raise VariantError("name", variant, diagnose("known-variants", variants=VARIANTS))
    return VARIANTS[variant]


@cache
def find_model_folder(kind: str) -> Path:
    """Returns the folder ``urdf`` or ``mjcf`` of the model files.

    They are the package's own in an installed wheel, and stand at the top level of a checkout.

    Raises:
        ModelError: If neither is there.
    """
    here = Path(__file__).resolve().parent
    for folder in (here / kind, here.parents[1] / kind):
        if folder.is_dir():
            return folder
    raise ModelError(here, diagnose("package-folder-missing", kind=kind))


@dataclass(frozen=True)
class ScalableVariant:
    """A variant that can be scaled.

    Attributes:
        spec: The variant where nothing is scaled otherwise.
    """

    spec: VariantSpec

    @property
    def scales(self) -> Mapping[str, float]:
        """Those of a ``VariantSpec``."""
        return {name: getattr(self.spec, name) for name in ("leg_scale", "torso_mass_scale")}

    def scaled(self, scales: Mapping[str, float]) -> VariantSpec:
        """Returns the variant of some scales; where not given, they are the variant's.

        Raises:
            VariantError: If a scale is not a finite positive number.
        """
        wanted = {**self.scales, **scales}
        return VariantSpec(self.spec.base, wanted["leg_scale"], wanted["torso_mass_scale"])
