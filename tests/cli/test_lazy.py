"""Commands are known by their table, and imported when they are used."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from pupper_analysis import cli

FOLDER = Path(cli.__file__).parent


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_command_is_where_the_table_has_it(name: str) -> None:
    assert cli.find_command(name).name == name


def test_the_table_has_every_command() -> None:
    written = {
        (f"pupper_analysis.cli.{file.stem}", node.name)
        for file in FOLDER.glob("*.py")
        for node in ast.parse(file.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and any("command(" in ast.unparse(one) for one in node.decorator_list)
    }
    assert written == {(place.module, place.attribute) for place in cli.COMMANDS.values()}


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [(["--help"], set()), (["diff", "--help"], {"guard", "models"})],
    ids=["the list of all", "one command"],
)
def test_a_command_imports_no_other(arguments: list[str], needed: set[str]) -> None:
    code = f"""
import sys
from pupper_analysis import cli
try:
    cli.run(cli.group, {arguments})
finally:
    print("imported", *sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = set(done.stdout.rpartition("imported ")[2].split())
    commands = {place.module for place in cli.COMMANDS.values()}
    assert commands & imported == {f"pupper_analysis.cli.{one}" for one in needed}
    assert "numpy" not in imported or needed
    for name, place in cli.COMMANDS.items():
        assert needed or f"{name} " in done.stdout
        assert needed or place.short_help in done.stdout
