"""What the service answers: python -m pytest charts/apps/__NAME__ (needs no ROS)."""

import ast
import importlib.util
from pathlib import Path

import pytest

FILES = Path(__file__).parents[1] / "files"


def load(name):
    """A module of the program, under a name of its own: other services have modules of the same names."""
    specification = importlib.util.spec_from_file_location(f"__ROS___{name}", FILES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize("text", ["hello", "", "Grüße, 世界"])
def test_a_text_is_repeated(text):
    assert load("answers").answer(text) == text


def test_the_program_uses_the_answers():
    tree = ast.parse((FILES / "node.py").read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert "answer" in imported
