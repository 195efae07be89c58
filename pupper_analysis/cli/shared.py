"""What the commands share: options, the reading of their values, the writing of results."""

from __future__ import annotations

from pathlib import Path

import click

from pupper_analysis.errors import ConfigurationError, OutputError

VERIFIED, FAILED, BAD_INPUT = 0, 1, 2
"""Exit statuses."""

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

json_option = click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write all results here."
)
figure_option = click.option("--figure", type=click.Path(path_type=Path), help="Draw it: a PNG.")
format_option = click.option(
    "--format",
    "style",
    type=click.Choice(["text", "github", "junit"]),
    default="text",
    show_default=True,
    help="For people, as GitHub annotations, or as JUnit XML.",
)


def check_outputs(*files: Path | None, folders: tuple[Path | None, ...] = ()) -> None:
    """Finds out before the work begins that its results cannot be written."""
    for path in (*folders, *(file.parent for file in files if file is not None)):
        if path is None:
            continue
        existing = next(parent for parent in (path, *path.absolute().parents) if parent.exists())
        if not existing.is_dir():
            raise OutputError(path, f"{existing} is not a folder")
    for file in files:
        if file is not None and file.is_dir():
            raise OutputError(file, "it is a folder; give the name of a file")


def assignment(option: str, text: str) -> tuple[str, str]:
    """Returns name and value of NAME=VALUE, or raises ConfigurationError for the option."""
    name, separator, value = text.partition("=")
    if not (name and separator and value):
        raise ConfigurationError(option, f"{text!r} is not of the form NAME=VALUE")
    return name, value


def number(option: str, text: str) -> tuple[str, float]:
    """Returns name and number of NAME=NUMBER, or raises ConfigurationError for the option."""
    name, value = assignment(option, text)
    try:
        return name, float(value)
    except ValueError as error:
        raise ConfigurationError(option, f"{value!r} in {text!r} is not a number") from error


def write_json(path: Path | None, content: object) -> None:
    """Writes results as JSON, if there is a file to write to."""
    from pupper_analysis.files import whole_file
    from pupper_analysis.results import to_json

    if path is not None:
        with whole_file(path) as temporary:
            temporary.write_text(to_json(content) + "\n")


def point(option: str, text: str, size: int = 2) -> tuple[float, ...]:
    """Returns the numbers of X,Y (or X,Y,Z), or raises ConfigurationError for the option."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != size:
        form = ",".join("XYZ"[:size])
        raise ConfigurationError(option, f"{text!r} is not of the form {form} (m)")
    return numbers
