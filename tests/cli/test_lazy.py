"""Commands are known by their tools' folders, and imported when they are used."""

import ast
import subprocess
import sys

import pytest

from pupper_analysis import cli
from pupper_analysis.base.tools import OWN, own_tools


@pytest.mark.parametrize("name", own_tools())
def test_a_tool_says_in_a_line_what_its_command_does(name: str) -> None:
    assert cli.find_command(name).name == name
    question = own_tools()[name].question
    assert 15 < len(question) < 60
    assert question[-1] in ".?"


def test_commands_are_written_in_tools_alone() -> None:
    written = {
        file.relative_to(OWN.parent).as_posix()
        for file in OWN.parent.rglob("*.py")
        for node in ast.parse(file.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and any("shared.command(" in ast.unparse(one) for one in node.decorator_list)
    }
    assert written == {f"tools/{name}/command.py" for name in own_tools()}
    assert {path.name for path in OWN.iterdir() if (path / "__init__.py").exists()} == set(
        own_tools()
    )


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [(["--help"], set()), (["diff", "--help"], {"diff"})],
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
    commands = {f"{tool.package}.command" for tool in own_tools().values()}
    assert commands & imported == {f"pupper_analysis.tools.{one}.command" for one in needed}
    assert "numpy" not in imported or needed
    for name, tool in own_tools().items():
        assert needed or f"{name} " in done.stdout
        assert needed or tool.question in done.stdout
