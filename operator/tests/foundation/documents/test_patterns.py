"""Identifiers have their patterns in one place, and the committed schemas hold the same ones.

What the first test cannot see: a pattern that is put together at run time or kept under a name that does not end in
PATTERN, one of letters alone or of negated classes (`[^/]+`), and what a module checks without a pattern.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.documents.core import patterns
from tests.stages.paths import REPOSITORY

ROOT = REPOSITORY
SOURCE = ROOT / "operator" / "src" / "robotkube"
HOME = "foundation/documents/core/patterns.py"
_LETTERS = "(?:[a-z]-[a-z]|[A-Z]-[A-Z])"
_DIGITS = r"(?:0-9|\\d)"
LETTERS_AND_DIGITS = re.compile(
    rf"\[[^\]]*{_LETTERS}[^\]]*{_DIGITS}|\[[^\]]*{_DIGITS}[^\]]*{_LETTERS}|(?<!\\)(?:\\\\)*\\w"
)
DIGITS_OR_WORD = re.compile(rf"{_DIGITS}|\\w")

NO_IDENTIFIERS = {
    ("foundation/documents/core/yaml_codec.py", "_PLAIN"): "text that YAML writes without quotes",
    ("robots/ros/adapters/rclpy_node.py", "_WORD_START"): "where a word begins inside a CamelCase name",
    ("robots/rules/adapters/cel.py", "_LOOP"): "where an expression names the variable of a loop",
    ("robots/bags/core/playback.py", "_LINE"): "a line of a ledger, with a bare SHA-256",
    ("registry/publication/core/submissions.py", "_EVIDENCE_FILE"): "a path, with the first letters of a digest",
    ("registry/admission/core/lists.py", "PARAMETER_KEY"): "a key of a ConfigMap, with a bare SHA-256",
    (
        "registry/images/skeletons/messages/compile_messages.py",
        "OTHER_PACKAGE",
    ): "a program of a build stage",
    ("registry/charts/core/challenges.py", "_SCHEME"): "a word of an HTTP header",
    ("registry/charts/core/challenges.py", "_PARAMETER"): "a parameter of an HTTP header",
    ("registry/suites/core/bill_comparison.py", "ESCAPED"): "bytes of a package's address that are escaped",
    ("registry/bundles/core/archives.py", "_NAME"): "a file's name, with the first letters of a digest",
    ("delivery/console/settings.py", "GROUP"): "a group as providers of sign-in name theirs",
    ("delivery/console/core/links.py", "_SERIES"): "a line of a bridge's metrics",
    ("delivery/console/adapters/web/guarding.py", "HOST_HEADER"): "an HTTP header",
    ("delivery/console/adapters/web/application.py", "FILE_NAME"): "what may not be in the name of a file",
}
SCHEMAS_ALONE = {
    r"\{\{": "a value template",
    "^([0-9]{1,6}(\\.[0-9]{1,3})?|[0-9]{1,9}m)$": "a quantity of processor time",
    "^[0-9]{1,9}(Ki|Mi|Gi)$": "a quantity of memory",
}


def literals(node: ast.Call | ast.Assign | ast.AnnAssign | ast.Dict, functions: frozenset[str]) -> Iterator[str]:
    """Patterns that a call compiles or matches, and those that a JSON schema keeps as texts."""
    if isinstance(node, ast.Call):
        function = ast.unparse(node.func)
        if (function in functions or function.rpartition(".")[0] in functions) and node.args:
            yield "".join(texts(node.args[0]))
        yield from ("".join(texts(keyword.value)) for keyword in node.keywords if keyword.arg == "pattern")
    elif isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and key.value == "pattern":
                yield "".join(texts(value))
    elif name_of(node).endswith("PATTERN") and node.value:
        yield "".join(texts(node.value))


def texts(node: ast.AST) -> Iterator[str]:
    return (part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str))


def name_of(node: ast.AST) -> str:
    if isinstance(node, ast.AnnAssign):
        return ast.unparse(node.target)
    return ast.unparse(node.targets[0]) if isinstance(node, ast.Assign) else ""


def of_re(tree: ast.AST) -> frozenset[str]:
    """What a module calls `re` and what it imports of it."""
    names = {"re"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.asname for alias in node.names if alias.name == "re" and alias.asname}
        elif isinstance(node, ast.ImportFrom) and node.module == "re":
            names |= {alias.asname or alias.name for alias in node.names}
    return frozenset(names)


def identifier_patterns(text: str) -> set[str]:
    """Names (the literal, where there is none) of a module's patterns that say what an identifier looks like."""
    if not DIGITS_OR_WORD.search(text):  # most modules: their syntax need not be read
        return set()
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    names = {id(node.value): name_of(node) for node in nodes if isinstance(node, ast.Assign | ast.AnnAssign)}
    functions = of_re(tree)
    identifiers = set()
    for node in nodes:
        if isinstance(node, ast.Call | ast.Assign | ast.AnnAssign | ast.Dict):
            wrong = [literal for literal in literals(node, functions) if LETTERS_AND_DIGITS.search(literal)]
            identifiers |= {names.get(id(node)) or name_of(node) or literal for literal in wrong}
    return identifiers


def schemas() -> list[Path]:
    return sorted((ROOT / "registry" / "schemas").glob("*.json"))


def patterns_of(schema: Any) -> Iterator[str]:
    for key, value in schema.items() if isinstance(schema, dict) else enumerate(schema):
        if key == "pattern" and isinstance(value, str):
            yield value
        elif isinstance(value, dict | list):
            yield from patterns_of(value)


def test_no_module_but_one_says_what_an_identifier_looks_like() -> None:
    modules = {path.relative_to(SOURCE).as_posix(): path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py")}
    elsewhere = {(path, name) for path, text in modules.items() if path != HOME for name in identifier_patterns(text)}
    assert elsewhere == set(NO_IDENTIFIERS), f"patterns of identifiers stand in {HOME}; others here, with a reason"


@pytest.mark.parametrize(
    "text",
    [
        'NAME = re.compile(r"[a-z0-9]+")',
        'NAME = re.compile(rf"{PREFIX}/[A-Za-z_][A-Za-z0-9_]*")',
        'x = re.fullmatch("[0-9a-f]{40}", y)',
        'TASK_PATTERN = "^[a-z0-9-]+$"',
        'X = {"type": "string", "pattern": "^[0-9A-Z]+$"}',
        'X = text("a name", pattern="^[a-z0-9]$")',
        r'NAME = re.compile(r"\w+")',
        r'NAME = re.compile(r"[a-z\d-]+")',
        'from re import compile\nNAME = compile("[a-z0-9]+")',
        'from re import fullmatch as whole\nwhole("[a-z0-9]+", y)',
        'import re as r\nNAME = r.compile("[a-z0-9]+")',
        'NAME_PATTERN: str = "^[a-z0-9-]+$"',
        'NAME: re.Pattern[str] = re.compile("[a-z0-9]+")',
    ],
)
def test_a_pattern_of_an_identifier_is_seen(text: str) -> None:
    assert identifier_patterns(f"import re\n{text}\n")


@pytest.mark.parametrize(
    "text",
    [
        'X = re.compile(r"[0-9]+")',
        'X = re.compile(r"\\d+\\\\\\\\word")',
        "NAME_PATTERN: str",
        "X = re.compile(NAME.pattern)",
        'X = "[a-z0-9] is a class"',
    ],
)
def test_other_patterns_and_texts_are_not(text: str) -> None:
    assert not identifier_patterns(f"import re\n{text}\n")


@pytest.mark.parametrize("path", schemas(), ids=lambda path: path.name)
def test_the_schemas_of_entries_hold_the_same_patterns(path: Path) -> None:
    known = {patterns.anchored(value) for value in vars(patterns).values() if isinstance(value, re.Pattern)}
    written = set(patterns_of(json.loads(path.read_text(encoding="utf-8"))))
    ranges = {text for text in written if patterns.VERSION.pattern in text}  # comparators with versions in them
    assert written - known - ranges - set(SCHEMAS_ALONE) == set()
