"""The files of a package that a process needs: its own module and all that may be imported from there, found in the
syntax trees, with the data files that lie in their packages.

An import counts wherever it stands, in a function too, except under `TYPE_CHECKING`, where nothing is imported when the
process runs. A text that is exactly a module's name counts like an import: that is how a process starts another one.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import PurePosixPath

from ci.imports import imports, module_name, package_of

PYTHON = ".py"
TOP = PurePosixPath(".")
MODULES_READ_MAX = 1024  # kept: services share most of theirs


def closure(sources: Mapping[str, bytes], roots: Sequence[str]) -> frozenset[str]:
    """The paths of `sources` (path from where imports begin -> content) that the modules `roots` need.

    ValueError names a root that is no module of `sources`.
    """
    modules = {module_name(PurePosixPath(path), TOP): path for path in sources if path.endswith(PYTHON)}
    unknown = sorted(set(roots) - modules.keys())
    if unknown:
        raise ValueError(f"no module {', '.join(unknown)}")
    needed: set[str] = set()
    waiting = list(roots)
    while waiting:
        module = waiting.pop()
        if module not in needed:
            needed.add(module)
            waiting += _needs(module, PurePosixPath(modules[module]), sources[modules[module]], modules)
    return frozenset({*(modules[module] for module in needed), *_data(sources, modules, needed)})


def _needs(module: str, path: PurePosixPath, content: bytes, modules: Mapping[str, str]) -> Iterator[str]:
    """What a module of `modules` needs of the others: the packages it lies in, and what it names."""
    parts = module.split(".")
    yield from (".".join(parts[:length]) for length in range(1, len(parts)))
    yield from _names_in(path, content) & modules.keys()


@lru_cache(MODULES_READ_MAX)
def _names_in(path: PurePosixPath, content: bytes) -> frozenset[str]:
    """Everything in a module that may name another one."""
    nodes = list(_running(ast.parse(content, str(path))))
    named = {name for one in imports(nodes, package_of(path, TOP)) for name in (one.module, one.whole)}
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return frozenset(named | texts)


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """The tree and all that is in it, but for what is only there for type checkers."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += node.orelse if isinstance(node, ast.If) and _is_checked(node.test) else ast.iter_child_nodes(node)


def _is_checked(test: ast.expr) -> bool:
    """Return whether a condition holds for type checkers alone."""
    return (test.attr if isinstance(test, ast.Attribute) else getattr(test, "id", "")) == "TYPE_CHECKING"


def _data(sources: Mapping[str, bytes], modules: Mapping[str, str], needed: set[str]) -> Iterator[str]:
    """Files that are no modules, of every needed package: those in its folder and in folders that are no packages."""
    for path in sources:
        if not path.endswith(PYTHON):
            owner = next((name for name in _folders(path) if name in modules), None)
            if owner in needed:
                yield path


def _folders(path: str) -> Iterator[str]:
    """The folders of a file as names of packages, the nearest first."""
    for folder in PurePosixPath(path).parents:
        yield ".".join(folder.parts)
