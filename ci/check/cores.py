"""Cores are pure: what a module below a `core` folder imports and calls, by lists of what it may.

The import contracts forbid names; what nobody thought of passes them. Here everything is refused that is not listed.
The rule reads the syntax tree and follows no values: a function that is passed in as an argument (a port) may do
anything, and who wants to get around it by attributes that are computed (`getattr`, `__subclasses__`) can.
"""

from __future__ import annotations

import ast
import builtins
import importlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

from ci.imports import dotted, imports, package_of

SHARED = ("robotkube.errors",)  # pure modules that are no subject's; the rule holds in them too
LIBRARIES = ("yaml", "semver")  # pure ones, by name, of those that operator/pyproject.toml declares
STANDARD = frozenset(
    [
        *("__future__", "abc", "array", "base64", "binascii", "bisect", "cmath", "collections", "collections.abc"),
        *("copy", "dataclasses", "datetime", "decimal", "enum", "fractions", "functools", "hashlib", "heapq", "hmac"),
        *(
            "ipaddress",
            "itertools",
            "json",
            "math",
            "operator",
            "re",
            "re._constants",
            "re._parser",
            "shlex",
            "statistics",
            "string",
            "struct",
        ),
        *("difflib", "textwrap", "types", "typing", "unicodedata", "zlib"),
    ]
)
PARTS = {  # standard modules that read files, the clock or the process too: what of them is pure
    "gzip": ("compress",),  # with `mtime`, below
    "sys": ("byteorder", "float_info", "maxsize"),
    "tarfile": ("AREGTYPE", "BLOCKSIZE", "HeaderError", "REGTYPE", "TarInfo", "USTAR_FORMAT"),
}
REFUSED_NAMES = frozenset(
    [
        *("__builtins__", "__import__", "__loader__", "__spec__", "breakpoint", "compile", "eval", "exec", "input"),
        *("open", "print"),
    ]
)
REFUSED_OBJECTS = tuple(vars(builtins)[name] for name in sorted(REFUSED_NAMES & set(vars(builtins))))
CLOCKS = ("now", "today", "utcnow")
ARGUMENTS_MIN = {"fromtimestamp": 2, "astimezone": 1}  # with fewer they read the machine's time zone


def findings(root: Path) -> list[str]:
    """What cores below `root`, the folder of robotkube, do that is not pure."""
    source = root.parent
    shared = [source.joinpath(*name.split(".")).with_suffix(".py") for name in SHARED]
    cores = [path for path in sorted(root.rglob("*.py")) if "core" in path.relative_to(root).with_suffix("").parts]
    loaded = sorted(
        {parent / "__init__.py" for path in cores for parent in path.parents if parent.is_relative_to(root)}
    )
    texts = {path: path.read_text(encoding="utf-8") for path in [*shared, *loaded, *cores] if path.is_file()}
    return [
        f"{path.relative_to(source).as_posix()}:{line}: {problem}; a core is pure (ci/check/cores.py)"
        for path, text in texts.items()
        for line, problem in impurities(text, package_of(path, source))
    ]


def impurities(text: str, package: str) -> Iterator[tuple[int, str]]:
    """Line and problem of everything in the text of a core, in `package`, that is not pure."""
    tree = ast.parse(text)
    for one in imports(ast.walk(tree), package):
        if one.module in PARTS and one.name:
            if one.name not in PARTS[one.module]:
                yield one.line, f"imports {one.whole}"
        elif not _may_import(one.module, one.name) or not _is_pure(one.module, one.name):
            yield one.line, f"imports {one.whole}"
    names = dict(_modules(tree))
    compressions = frozenset(_compressions(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in REFUSED_NAMES:
            yield node.lineno, f"uses {node.id}"
        elif isinstance(node, ast.Attribute):
            module = names.get(dotted(node.value), "")
            if node.attr in CLOCKS or (module and not _is_pure(module, node.attr)):
                yield node.lineno, f"uses {ast.unparse(node)}"
        elif isinstance(node, ast.Call):
            function = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            if len(node.args) + len(node.keywords) < ARGUMENTS_MIN.get(function, 0):
                yield node.lineno, f"calls {function} without a time zone"
            if _is_compression(node, names, compressions) and not any(
                keyword.arg == "mtime" for keyword in node.keywords
            ):
                yield node.lineno, "calls gzip.compress without mtime, which reads the clock"


def _may_import(module: str, name: str) -> bool:
    if module.partition(".")[0] == "robotkube":
        whole = f"{module}.{name}" if name else ""  # `import robotkube.a` gives all that is loaded of robotkube
        return bool(name) and (module in SHARED or whole in SHARED or "core" in whole.split(".")[1:])
    return module in STANDARD or module in PARTS or module.partition(".")[0] in LIBRARIES


def _is_pure(module: str, attribute: str) -> bool:
    """Return whether what a module holds under a name is listed, and no other module and none of the refused
    functions."""
    if module in PARTS:
        return not attribute or attribute in PARTS[module]
    if not attribute or module.partition(".")[0] == "robotkube":
        return True
    held = getattr(_loaded(module), attribute, None)
    if isinstance(held, ModuleType):
        return _may_import(held.__name__, "") and held.__name__ not in PARTS
    return not any(held is refused for refused in REFUSED_OBJECTS)


@cache
def _loaded(module: str) -> ModuleType:
    return importlib.import_module(module)


def _modules(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """What each module outside robotkube that may be imported is called in a text, and its name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if _may_import(alias.name, ""):
                    yield alias.asname or alias.name, alias.name
                    if not alias.asname:
                        yield alias.name.partition(".")[0], alias.name.partition(".")[0]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if _may_import(whole, "") and node.module in STANDARD:
                    held = getattr(_loaded(node.module), alias.name, None)
                    if isinstance(held, ModuleType):
                        yield alias.asname or alias.name, whole


def _compressions(tree: ast.AST) -> Iterator[str]:
    """What each name that is imported of gzip is called in a text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "gzip":
            yield from (alias.asname or alias.name for alias in node.names)


def _is_compression(call: ast.Call, names: dict[str, str], compressions: frozenset[str]) -> bool:
    if isinstance(call.func, ast.Attribute):
        return call.func.attr == "compress" and names.get(dotted(call.func.value)) == "gzip"
    return isinstance(call.func, ast.Name) and call.func.id in compressions
