"""Number of prims that the layers of a USD file describe, counted before USD composes a stage.

A prim may contain two references to another prim, which contains two references to a third prim. A
file of 3 kB with 30 such prims describes 2^31 prims. USD composes each prim, and needs 34 s and 0.7
GB for 65,000.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import Diagnostic, diagnose

MAX_PRIMS: Final = 100_000
"""Maximum number of prims of a file, counted by `_PrimCounter`. Larger files are refused. Chosen:
robots have some thousand prims.
"""


def check_prim_count(path: Path) -> Diagnostic | None:
    """Check the number of prims of a USD file before opening, and return the reason for a refusal.

    Returns:
        Reason; None if the file is not refused here.

    Raises:
        pxr.Tf.ErrorException: If the file is not valid.
    """
    from pxr import Sdf  # slow to import

    layer = Sdf.Layer.FindOrOpen(str(path.absolute()))
    if layer is None:
        return None  # opening the stage fails, and states the reason
    try:
        count = _PrimCounter().count(layer, Sdf.Path.absoluteRootPath)
    except RecursionError:
        return diagnose("usd-references-too-deep")
    return diagnose("usd-has-too-many-prims", most=MAX_PRIMS) if count > MAX_PRIMS else None


class _PrimCounter:
    """Estimates of the number of prims below a path of a layer, each computed once.

    All variants of a prim are counted, not only the selected variant.
    """

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], int] = {}
        self._layers: dict[str, Any] = {}

    def count(self, layer: Any, path: Any) -> int:
        """Return the number of prims at and below a path of a layer and the sublayers.

        A reference of a prim to the prim itself or to an ancestor, which USD ignores, counts as
        zero.
        """
        key = (layer.identifier, str(path))
        if key not in self._counts:
            self._counts[key] = 0
            spec = layer.GetPrimAtPath(path)
            own = 0 if spec is None else self._count_spec(layer, spec)
            sublayers = [self._open_layer(layer, name) for name in layer.subLayerPaths]
            self._counts[key] = own + sum(
                self.count(sublayer, path) for sublayer in sublayers if sublayer is not None
            )
        return self._counts[key]

    def _count_spec(self, layer: Any, spec: Any) -> int:
        """Return the number of prims that a prim specification in a layer can produce.

        Children, variants and referenced prims are included.
        """
        from pxr import Sdf

        total = 1 + sum(self.count(layer, child.path) for child in spec.nameChildren)
        total += sum(
            self.count(layer, variant.primSpec.path)
            for variants in spec.variantSets
            for variant in variants.variantList
        )
        arcs = (*_list_added(spec.referenceList), *_list_added(spec.payloadList))
        for arc in arcs:
            target = self._open_layer(layer, arc.assetPath) if arc.assetPath else layer
            name = "" if target is None else str(arc.primPath) or target.defaultPrim
            if name:
                total += self.count(target, Sdf.Path.absoluteRootPath.AppendPath(name.lstrip("/")))
        inherited = (*_list_added(spec.inheritPathList), *_list_added(spec.specializesList))
        return total + sum(self.count(layer, path) for path in inherited)

    def _open_layer(self, layer: Any, name: str) -> Any:
        """Open the USD layer to which another layer refers; None if USD cannot open the layer."""
        from pxr import Sdf, Tf

        path = layer.ComputeAbsolutePath(name)
        if path not in self._layers:
            try:
                self._layers[path] = Sdf.Layer.FindOrOpen(path)
            except Tf.ErrorException:
                self._layers[path] = None
        return self._layers[path]


def _list_added(operations: Any) -> tuple[Any, ...]:
    """Return the items that a USD list editor (`Sdf.ListEditorProxy`) adds or sets explicitly."""
    return tuple(operations.GetAddedOrExplicitItems())
