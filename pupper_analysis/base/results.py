"""Base classes of results, and the conversion to JSON, dictionaries and tables.

A result is a dataclass; its fields that are dictionaries or arrays are read-only. `Result` provides
a short ``repr``, JSON, and plots; `Tabular` a pandas table; `Pictured` pictures and animations of
the robot. Plots and pictures are made by the package ``present``, which is imported at the first
use.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from importlib import import_module
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np
import orjson
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Phrase, diagnose, format_pair
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError
from pupper_analysis.base.frozen import FrozenDict, ReadOnlyFields
from pupper_analysis.base.notebook import (
    list_shown_fields,
    list_warnings,
    zero_rounding_errors,
)
from pupper_analysis.base.units import get_field_units, replace_joint_units

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from PIL.Image import Image


def to_json(result: object) -> str:
    """Return a result, or a container of results, as indented JSON.

    Arrays become lists. Infinite values and NaN become null.

    Raises:
        ConfigurationError: If a value has no JSON equivalent, such as bytes.
    """
    options = (
        orjson.OPT_SERIALIZE_NUMPY
        | orjson.OPT_INDENT_2
        | orjson.OPT_NON_STR_KEYS
        | orjson.OPT_PASSTHROUGH_DATACLASS
    )
    try:
        return orjson.dumps(result, default=to_plain, option=options).decode()
    except orjson.JSONEncodeError as error:
        if isinstance(error.__cause__, ConfigurationError):
            raise error.__cause__ from None
        message = diagnose("no-json", problem=str(error))
        raise ConfigurationError("result", message) from error


def to_plain(value: Any) -> Any:
    """Convert a dataclass, diagnostic, array, mapping, path or float subclass for JSON.

    Nested values are not converted: the JSON encoder calls this function for each value that it
    cannot encode. A dataclass becomes a dictionary of the public fields, and of the properties that
    its class lists in ``_reported``.

    Raises:
        ConfigurationError: If the type is not supported.
    """
    if isinstance(value, Diagnostic):
        return value.to_dict()
    if is_dataclass(value):
        names = [f.name for f in fields(value) if f.name[0] != "_"]
        return {name: getattr(value, name) for name in (*names, *getattr(value, "_reported", ()))}
    if hasattr(value, "tolist"):  # array that is not contiguous
        return value.tolist()
    if hasattr(value, "keys"):  # mapping other than dict
        return dict(value)
    if isinstance(value, float | PurePath):  # float: subclass with a unit
        return str(value) if isinstance(value, PurePath) else float(value)
    raise ConfigurationError("result", diagnose("no-json-of", type=type(value).__name__))


MAX_REPR_LENGTH = 200
"""Maximum number of characters of ``repr``; further fields are omitted. Chosen, not tuned: two or
three lines of a terminal."""

_MAX_WARNING_LENGTH = 140
"""Maximum number of characters of the warnings of a field in ``repr``, without quotes and dots.
Chosen below `MAX_REPR_LENGTH`, so that key fields follow; not tuned."""

_MAX_VALUE_LENGTH = 80
"""Maximum number of characters of a field's value in ``repr``. Chosen, not tuned."""

_MAX_NESTED_FIELDS = 2
"""Maximum number of fields of a nested result that ``repr`` shows. Chosen, not tuned."""

_MAX_SHOWN_ITEMS = 3
"""Maximum number of items of a container that ``repr`` shows. Chosen, not tuned: a position (3,) is
shown completely.
"""


class Result(ReadOnlyFields):
    """Base class of results. Fields that are dictionaries or arrays are read-only.

    Arrays in a tuple or list are writeable. ``repr`` is short: long arrays and lists are
    represented by their sizes. ``to_json`` returns all public fields, and the properties that the
    class lists in ``_reported``. Properties that the class lists in ``_warnings`` are the first
    items of ``repr`` and of the table, if their values are not empty. Fields and properties that
    the class lists in ``_key_fields`` precede the other fields in ``repr``.
    """

    _reported: ClassVar[tuple[str, ...]] = ()
    _warnings: ClassVar[tuple[str, ...]] = ()
    _key_fields: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        # The decorator of a dataclass writes a __repr__, unless the class itself has one.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]
        cls.__doc__ = _add_inherited_fields(cls)

    def __repr__(self) -> str:
        name = type(self).__name__
        items = [f"{field}={_join_texts(value)}" for field, value in list_warnings(self)]
        items += [f"{field}={shorten(getattr(self, field))}" for field in list_shown_fields(self)]
        return f"{name}({_join_items(items, MAX_REPR_LENGTH - len(name) - 2)})"

    def _field_units(self) -> Mapping[str, str | Mapping[str, str]]:
        """Return {field: unit} of fields whose unit depends on other fields.

        The unit of a field with a mapping can be a mapping {key: unit}.
        """
        return {}

    def __dir__(self) -> list[str]:
        """Return the names for ``dir`` and completion, without ``plot`` if there is no plot."""
        names = sorted(super().__dir__())
        plots = import_module("pupper_analysis.present.plots")
        return names if plots.has_plot(self) else [name for name in names if name != "plot"]

    def _repr_html_(self) -> str:
        """Return a table of fields, values and units, for notebooks."""
        from pupper_analysis.base.notebook import render_result

        return render_result(self)

    def plot(
        self,
        robot: object = None,
        *,
        ax: Axes | None = None,
        figure: Figure | SubFigure | None = None,
    ) -> tuple[Axes, ...]:
        """Draw the plots of the result with Matplotlib, by default in a new figure of ``pyplot``.

        For most results, these are the plots of the HTML report; for a ``Stand``, the skeleton with
        contact forces.

        Args:
            robot: Robot of the result; necessary for a stand from another process.
            ax: Axes of a plot with a single panel, in place of a new figure.
            figure: Figure or subfigure without axes, in place of a new figure.

        Returns:
            Axes of the panels.

        Raises:
            ConfigurationError: For example if the result has no plot, the robot is missing, or
                ``ax`` is given for a plot with several panels.
            StaticsInfeasibleError: If no contact forces balance a stand that is drawn.
        """
        # By name, because ``present`` is a higher layer, which imports this module.
        plots = import_module("pupper_analysis.present.plots")
        axes: tuple[Axes, ...] = plots.plot_result(self, robot, ax=ax, figure=figure)
        return axes

    def to_json(self) -> str:
        """Return the result as indented JSON."""
        return to_json(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as dictionaries, lists, numbers and texts.

        Infinite values and NaN become None.
        """
        value: dict[str, Any] = orjson.loads(self.to_json())
        return value


def _add_inherited_fields(kind: type) -> str | None:
    """Return the docstring of a class with the names of the inherited fields, by base class."""
    text, known = kind.__doc__, set(kind.__annotations__)
    if text is None:
        return None
    for base in filter(is_dataclass, kind.__mro__[1:]):
        own = [name for name in vars(base).get("__annotations__", {}) if name[0] != "_"]
        names = [item.name for item in fields(base) if item.name in own and item.name not in known]
        known |= set(names)
        if names:
            listed = ", ".join(f"``{name}``" for name in names)
            sentence = f"Inherited fields, described in ``{base.__name__}``: {listed}."
            indent = "    "
            filled = textwrap.fill(
                sentence,
                100,
                initial_indent=indent,
                subsequent_indent=indent,
                break_on_hyphens=False,
            )
            text = f"{text.rstrip()}\n\n{filled}\n{indent}"
    return text


class Pictured:
    """Result that contains configurations of a robot, which MuJoCo's renderer draws."""

    def show(self, robot: object = None, **options: Any) -> Image | None:
        """Show the robot in the configuration of the result: in MuJoCo's viewer, or as a picture.

        The last configuration of a simulated motion is shown. In a notebook, or without a display,
        a Pillow image is returned. Otherwise the viewer simulates the robot until its window is
        closed, and None is returned.

        Args:
            robot: Robot of the result; necessary, for example, for a stand from another process.
            **options: Of the picture: ``size`` (width, height) [pixel], ``azimuth`` and
                ``elevation`` of the camera in MuJoCo's convention [deg].

        Raises:
            ConfigurationError: For example if the result has no picture, or an option is unknown.
            DisplayError: If the robot cannot be drawn, for example without OpenGL.
        """
        pictures = import_module("pupper_analysis.present.pictures")
        image: Image | None = pictures.show_result(self, robot, **pictures.check_options(options))
        return image

    def animate(self, robot: object = None, **options: Any) -> Any:
        """Return an animation: the simulated motion, or a turn of the camera around a posture.

        Notebooks display the animation. ``animation.save("stand.gif")`` writes a GIF, and with the
        package ``imageio[ffmpeg]`` an MP4; ``animation.frames`` contains the pixels.

        Args:
            robot: Robot of the result; necessary, for example, for a stand from another process.
            **options: ``size`` (width, height) [pixel], ``azimuth`` and ``elevation`` of the camera
                in MuJoCo's convention [deg].

        Raises:
            ConfigurationError: For example if the result has no picture, or an option is unknown.
            DisplayError: If the robot cannot be drawn, for example without OpenGL.
        """
        pictures = import_module("pupper_analysis.present.pictures")
        return pictures.animate_result(self, robot, **pictures.check_options(options))


class Tabular(Result):
    """Base class of results that are tables, for example with a row per joint or sample.

    ``_units_of_columns`` contains {column: unit} of the columns that are no fields. The key
    ``"q *"`` is for all columns whose names start with ``q`` and a space.
    """

    _units_of_columns: ClassVar[Mapping[str, str]] = {}

    def _columns(self) -> Mapping[str, ArrayLike | Iterable[object]]:
        """Return {column: values} of this result as a table; all columns have equal length."""
        raise NotImplementedError

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table of this result as a pandas ``DataFrame``, in the units of the fields.

        ``frame.attrs["units"]`` contains {column: unit}; ``1`` for ratios, nothing for texts.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise MissingPackageError("pandas", "pandas") from error
        frame = pd.DataFrame({name: list(values) for name, values in self._columns().items()})  # type: ignore[arg-type]
        frame.attrs["units"] = self._column_units(map(str, frame.columns))
        return frame

    def _column_units(self, columns: Iterable[str]) -> dict[str, str]:
        """Return {column: unit} from ``_units_of_columns``, or from the field of the same name."""
        names = list(columns)
        # A column of units states the unit of each row.
        units = {} if "unit" in names else get_field_units(self)
        listed = replace_joint_units(self, self._units_of_columns)
        found = {}
        for column in names:
            prefix = f"{column.split(' ')[0]} *"
            unit = listed.get(column) or units.get(column) or listed.get(prefix)
            if isinstance(unit, str) and unit:
                found[column] = unit
        return found


def shorten(value: object, other: object = None) -> str:
    """Return a short text of a value, for ``repr``; a long container is represented by its size.

    ``other`` is a second value that is printed beside ``value`` for comparison: if possible, digits
    are added until different numbers have different texts.
    """
    if isinstance(value, Enum):
        return repr(value.value)
    if isinstance(value, float):
        return format_pair(value, other if isinstance(other, float) else value, ".6g")[0]
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else f"{value[:57]}...")
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= _MAX_SHOWN_ITEMS:
            return f"[{', '.join(_shorten_items(value, other))}]"
        return f"<array {' x '.join(map(str, value.shape))}>"
    text = _shorten_container(value, other)
    return text if len(text) <= _MAX_VALUE_LENGTH else f"{text[: _MAX_VALUE_LENGTH - 4]} ..."


def _shorten_container(value: object, other: object) -> str:
    """Return a short text of a mapping, sequence, result or other object; see `shorten`."""
    if isinstance(value, Mapping):
        names = ", ".join(map(str, list(value)[:_MAX_SHOWN_ITEMS])) + (
            ", ..." if len(value) > _MAX_SHOWN_ITEMS else ""
        )
        return f"<{len(value)}: {names}>" if value else "{}"
    if isinstance(value, tuple | list):
        if len(value) <= _MAX_SHOWN_ITEMS and all(
            isinstance(item, str | float | int) for item in value
        ):
            return f"({', '.join(_shorten_items(value, other))})"
        first = value[0]
        if not getattr(first, "_key_fields", ()):
            return f"<{len(value)} {type(first).__name__}>"
        return f"<{len(value)}: {shorten(first)}{', ...' if len(value) > 1 else ''}>"
    if isinstance(value, Diagnostic):
        return repr(str(value))
    text = repr(value) if not isinstance(value, Result) else ""
    if is_dataclass(value) and not isinstance(value, type) and not 0 < len(text) <= 60:
        return _shorten_dataclass(value)
    if " at 0x" in text or "\n" in text:  # the default of objects, and tables
        name = getattr(value, "__name__", type(value).__name__)
        shape = getattr(value, "shape", ())
        return f"<{' '.join([name, ' x '.join(map(str, shape))]).strip()}>"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _shorten_dataclass(value: Any) -> str:
    """Return a short text of a nested dataclass: its class, and at most two simple fields."""
    simple = [
        name
        for name in list_shown_fields(value)
        if isinstance(getattr(value, name), str | int | float | Enum)
    ]
    items = [f"{name}={shorten(getattr(value, name))}" for name in simple[:_MAX_NESTED_FIELDS]]
    if len(items) < len(fields(value)):
        items.append("...")
    return f"{type(value).__name__}({', '.join(items)})"


def _join_items(items: Sequence[str], length: int) -> str:
    """Join items by commas, as many as fit into ``length`` characters; dots replace the others."""
    text = ", ".join(items)
    num_kept = len(items)
    while len(text) > length and num_kept:
        num_kept -= 1
        text = ", ".join((*items[:num_kept], "..."))
    return text


def _join_texts(value: object) -> str:
    """Return the text of a warning, or the texts of several, separated by semicolons, in quotes."""
    text = "; ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return repr(text if len(text) <= _MAX_WARNING_LENGTH else f"{text[:_MAX_WARNING_LENGTH]}...")


def _shorten_items(values: Sequence[object] | np.ndarray, other: object) -> list[str]:
    """Return a short text of each item of a vector, by `shorten`.

    ``other`` is a vector that is printed beside ``values``, for comparison. Without it, rounding
    errors in an array are written as 0 (`zero_rounding_errors`).
    """
    if other is None and isinstance(values, np.ndarray) and values.dtype.kind == "f":
        values = zero_rounding_errors(values)
    items = list(values)
    compared = list(other) if isinstance(other, tuple | list | np.ndarray) else []
    if len(compared) != len(items):
        compared = items
    return [
        shorten(_to_python_scalar(item), _to_python_scalar(beside))
        for item, beside in zip(items, compared, strict=True)
    ]


def _to_python_scalar(item: object) -> object:
    """Convert a NumPy scalar to a Python object; return other items unchanged."""
    return item.item() if isinstance(item, np.generic) else item


def __dir__() -> list[str]:
    """Return the names for ``dir``, without imported objects and most constants."""
    return sorted(
        name
        for name, value in globals().items()
        if name.startswith("__") or getattr(value, "__module__", None) == __name__
    )


_Value = TypeVar("_Value")
"""Type of a value whose texts `shorten_paths` shortens."""


def shorten_paths(value: _Value, prefix: str) -> _Value:
    """Remove the path of a temporary folder from the texts and paths in a value.

    ``prefix`` is the path of the folder. Tuples, the values of dictionaries and the ``init`` fields
    of dataclasses are searched.
    """
    return cast(_Value, _replace_text(value, prefix, ""))


def shorten_memory_paths(value: _Value, *paths: Path) -> _Value:
    """Replace the paths of robots in memory in a value by the names, such as ``<MjSpec pupper>``.

    The path of a robot in memory consists of the folder of the meshes and the name in ``<>``; it is
    not a file. If ``paths`` contains other paths, these are not replaced.
    """
    for path in paths:
        if path.name.startswith("<") and path.name != str(path):
            value = cast(_Value, _replace_text(value, str(path), path.name))
    return value


def _replace_text(value: Any, prefix: str, short: str) -> Any:
    """Replace each occurrence of a text in the texts and paths in a value; see `shorten_paths`."""
    if isinstance(value, Phrase):
        texts = str(value), value.chinese
        return (
            Phrase(*(text.replace(prefix, short) for text in texts)) if prefix in value else value
        )
    if isinstance(value, str):
        return type(value)(value.replace(prefix, short)) if prefix in value else value
    if isinstance(value, Path):
        return Path(str(value).replace(prefix, short)) if prefix in str(value) else value
    if type(value) in (tuple, dict, FrozenDict):
        old = value if isinstance(value, tuple) else tuple(value.values())
        new = tuple(_replace_text(item, prefix, short) for item in old)
        if all(old_item is new_item for old_item, new_item in zip(old, new, strict=True)):
            return value
        kind = type(value)
        return new if kind is tuple else kind(zip(value, new, strict=True))
    if not is_dataclass(value) or isinstance(value, type):
        return value
    changes = {
        field.name: new
        for field in fields(value)
        if field.init
        and (new := _replace_text(old := getattr(value, field.name), prefix, short)) is not old
    }
    return replace(value, **changes) if changes else value
