"""What a module of Python imports, read from its syntax tree: anywhere in it, under `TYPE_CHECKING` too, relative or by
a call with a literal name.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import PurePath
from typing import NamedTuple

IMPORTERS = ("__import__", "importlib.import_module", "importlib.__import__", "import_module")
CALLED = ("__import__", "import_module")
"""What an importer's name ends with: without one of them in it, no call in a text imports."""

BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


class Import(NamedTuple):
    """One name that is imported: `name` of the module `module`; without `name`, the module itself."""

    line: int
    module: str
    name: str = ""

    @property
    def whole(self) -> str:
        return f"{self.module}.{self.name}" if self.name else self.module


def module_name(path: PurePath, root: PurePath) -> str:
    """What the file `path` is imported as, when `root` is where imports begin."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def package_of(path: PurePath, root: PurePath) -> str:
    """The package that relative imports of the file `path` begin at."""
    return ".".join(path.relative_to(root).parts[:-1])


def imports_in(text: str, package: str) -> Iterator[Import]:
    """Every import in the text of a module that lies in `package`. Expressions, which are most of a module, are looked
    through only where one of them may import."""
    tree = ast.parse(text)
    return imports(ast.walk(tree) if any(name in text for name in CALLED) else statements(tree), package)


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """The tree, and every statement in it, with the handlers and cases that statements lie in."""
    yield tree
    for block in BLOCKS:
        for inner in getattr(tree, block, ()):
            yield from statements(inner)


def imports(nodes: Iterable[ast.AST], package: str) -> Iterator[Import]:
    """Every import among the nodes of a module that lies in `package`."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (Import(node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = absolute("." * node.level + (node.module or ""), package)
            yield from (Import(node.lineno, module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Call) and dotted(node.func) in IMPORTERS:
            literal = node.args[0] if node.args else next((k.value for k in node.keywords if k.arg == "name"), None)
            if isinstance(literal, ast.Constant) and isinstance(literal.value, str):
                yield Import(node.lineno, absolute(literal.value, package))


def dotted(node: ast.AST) -> str:
    """The text of a name or of attributes of a name; empty for any other expression."""
    if isinstance(node, ast.Name):
        return node.id
    owner = dotted(node.value) if isinstance(node, ast.Attribute) else ""
    return f"{owner}.{node.attr}" if isinstance(node, ast.Attribute) and owner else ""


def absolute(name: str, package: str) -> str:
    """A module's name without leading dots: one stands for `package`, each further one for the package above."""
    stem = name.lstrip(".")
    level = len(name) - len(stem)
    if not level:
        return name
    parents = package.split(".")[: len(package.split(".")) - level + 1]
    return ".".join([*parents, stem] if stem else parents)
