"""Tuple assignments: values that are given in one statement are of one kind, as two ends of one span are.

What has nothing to do with each other is two statements. Values are of one kind when they are literals of one type,
calls of functions of one name, all sums or all products, or otherwise expressions of one form. A statement that reads
what it assigns (`before, self.before = self.before, now`) needs both at once.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

ALIKE = {ast.Add: "sum", ast.Sub: "sum", ast.Mult: "product", ast.FloorDiv: "product", ast.Mod: "product"}


def findings(name: str, text: str) -> list[str]:
    """Tuple assignments in the text of a module that mix kinds of values."""
    return [
        f"{name}:{line}: {', '.join(targets)} are given values of several kinds at once; assign each by itself"
        for line, targets in mixed(ast.parse(text))
    ]


def mixed(tree: ast.AST) -> Iterator[tuple[int, list[str]]]:
    """Line and targets of each tuple assignment whose values are of several kinds."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and len(target.elts) == len(node.value.elts):
                    kinds = {_kind(value) for value in node.value.elts}
                    if len(kinds) > 1 and not _reads_what_it_assigns(target, node.value):
                        yield node.lineno, [ast.unparse(elt) for elt in target.elts]


def _kind(value: ast.expr) -> str:
    """The form of a value: its type for a literal, what is called for a call."""
    if isinstance(value, ast.UnaryOp):
        return _kind(value.operand)
    if isinstance(value, ast.BinOp):
        calculated = _kind(value.left) == _kind(value.right) == "number"
        operator = type(value.op)
        return "number" if calculated else ALIKE.get(operator, operator.__name__)
    if isinstance(value, ast.Constant):
        return "number" if type(value.value) in (int, float) else type(value.value).__name__
    if isinstance(value, ast.Call):
        function = value.func.value if isinstance(value.func, ast.Subscript) else value.func
        return f"call of {function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)}"
    return "text" if isinstance(value, ast.JoinedStr) else type(value).__name__


def _reads_what_it_assigns(target: ast.Tuple, value: ast.Tuple) -> bool:
    assigned = {ast.unparse(elt) for elt in target.elts}
    read = {ast.unparse(node) for node in ast.walk(value) if isinstance(node, ast.Name | ast.Attribute | ast.Subscript)}
    return bool(assigned & read)
