"""Templates of the catalogue by Jinja2: sandboxed, strict, bounded; a text that is one expression keeps its type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from itertools import chain, islice
from typing import Any

import jinja2
from jinja2 import nativetypes, nodes, sandbox

from robotkube.errors import DocumentError

TEMPLATE_CHARACTERS_MAX = 4096
RESULT_CHARACTERS_MAX = 64 * 1024
ITEMS_MAX = 20_000
DEPTH_MAX = 32
TEMPLATES_CACHED_MAX = 1024

_TESTS = ("defined", "undefined", "none", "string", "number", "mapping", "sequence", "in", "eq", "ne")
_FILTERS = ("default", "first", "int", "float", "last", "length", "lower", "sort", "upper")


class _Environment(sandbox.ImmutableSandboxedEnvironment):
    """Expressions without calls, and few filters and operators, all of bounded cost."""

    intercepted_binops = frozenset(["*", "**", "%"])

    def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
        """Numbers only: a text times a number or with a width would grow without bound; powers as well."""
        if operator == "**" or not all(isinstance(side, (int, float)) for side in (left, right)):
            raise jinja2.TemplateRuntimeError(f"operator {operator} is not allowed here")
        return left * right if operator == "*" else left % right


def _concatenate(values: Any) -> Any:
    """One part keeps its type; several are joined as text. (Jinja2's own would read `007` or `[1]` as a literal.)"""
    head = list(islice(values, 2))
    if len(head) == 1:
        return head[0]
    parts = []
    length = 0
    for part in chain(head, values):
        parts.append(str(part))
        length += len(parts[-1])
        if length > RESULT_CHARACTERS_MAX:
            raise jinja2.TemplateRuntimeError(f"result longer than {RESULT_CHARACTERS_MAX} characters")
    return "".join(parts)


class _Template(nativetypes.NativeTemplate):
    environment_class = _Environment  # type: ignore[assignment]  # sandbox and native types are not one class there

    def render(self, *args: Any, **kwargs: Any) -> Any:
        """The value of the template."""
        context = self.new_context(dict(*args, **kwargs))
        return _concatenate(self.root_render_func(context))


class _CodeGenerator(nativetypes.NativeCodeGenerator):
    @staticmethod
    def _default_finalize(value: Any) -> Any:
        return value


_Environment.code_generator_class = _CodeGenerator
_Environment.template_class = _Template


def _ros(name: Any) -> str:
    """The agent's name as a part of ROS names: `vehicle-00` -> `vehicle_00`."""
    return str(name).replace("-", "_")


def _join(values: Any, separator: Any = "") -> str:
    """The texts of a list joined; not a text's letters, whose repeated joining would grow without bound."""
    if not isinstance(values, list):
        raise jinja2.TemplateRuntimeError(f"join needs a list, got {type(values).__name__}")
    return str(separator).join(str(value) for value in values)


def _where(values: Any, key: Any, wanted: Any, default: Any = None) -> list[Any]:
    """The mappings of a list in which `key` is `wanted`; where it is missing, `default` stands for it."""
    if not isinstance(values, list) or not all(isinstance(value, Mapping) for value in values):
        raise jinja2.TemplateRuntimeError("where needs a list of mappings")
    return [value for value in values if value.get(key, default) == wanted]


def _make_environment() -> _Environment:
    environment = _Environment(undefined=jinja2.StrictUndefined, autoescape=False, keep_trailing_newline=True)
    own = {"join": _join, "ros": _ros, "where": _where}
    environment.filters = {name: environment.filters[name] for name in _FILTERS} | own
    environment.tests = {name: environment.tests[name] for name in _TESTS}
    environment.globals = {}
    return environment


@contextmanager
def _refusals(text: str) -> Iterator[None]:
    """Everything that a template can do wrong becomes a DocumentError that names it."""
    if len(text) > TEMPLATE_CHARACTERS_MAX:
        raise DocumentError("template", [f"longer than {TEMPLATE_CHARACTERS_MAX} characters: {text[:40]!r}..."])
    try:
        yield
    except (RecursionError, SyntaxError, MemoryError) as error:  # of Python, which compiles what Jinja2 wrote
        raise DocumentError(f"template {text[:80]!r}...", ["nested too deeply; write it flatter"]) from error
    except (jinja2.TemplateError, TypeError, ValueError, ArithmeticError, LookupError, AttributeError) as error:
        raise DocumentError(f"template {text!r}", [str(error) or type(error).__name__]) from error


_ENVIRONMENT = _make_environment()


def _parsed(text: str) -> nodes.Template:
    """The template's tree; only expressions are in it."""
    tree = _ENVIRONMENT.parse(text)
    for node in tree.find_all((nodes.Stmt, nodes.Call)):
        if not isinstance(node, (nodes.Output, nodes.If)):
            raise jinja2.TemplateSyntaxError(f"{type(node).__name__} is not allowed; use expressions", node.lineno)
    return tree


@lru_cache(TEMPLATES_CACHED_MAX)
def _compiled(text: str) -> jinja2.Template:
    """The template of a text: known to all of a process, since nothing but the text is in it."""
    return _ENVIRONMENT.from_string(_parsed(text))


@lru_cache(TEMPLATES_CACHED_MAX)
def _referred(text: str) -> frozenset[tuple[str, ...]]:
    """The names that a template refers to, each with its first key when that is written out."""
    with _refusals(text):
        tree = _parsed(text)
    names: set[tuple[str, ...]] = {(node.name,) for node in tree.find_all(nodes.Name)}
    for by_name in tree.find_all(nodes.Getattr):
        if isinstance(by_name.node, nodes.Name):
            names.add((by_name.node.name, by_name.attr))
    for by_key in tree.find_all(nodes.Getitem):
        if isinstance(by_key.node, nodes.Name) and isinstance(by_key.arg, nodes.Const):
            names.add((by_key.node.name, str(by_key.arg.value)))
    return frozenset(names)


class Jinja2Templates:
    """Templates by Jinja2: `render` renders every text of a JSON value; keys are not templates. DocumentError names the
    template."""

    def render(self, value: Any, names: Mapping[str, Any]) -> Any:
        """`value` with all templates rendered with `names`."""
        budget = [ITEMS_MAX]
        return self._render(value, names, budget, 0)

    def references(self, text: str) -> frozenset[tuple[str, ...]]:
        """The names that a template refers to, each with its first key when that is written out: `("agent",)`,
        `("parameters", "vehicles")`. DocumentError when it is no template that could be rendered."""
        return _referred(text) if "{" in text else frozenset()

    def _render(self, value: Any, names: Mapping[str, Any], budget: list[int], depth: int) -> Any:
        budget[0] -= 1
        if budget[0] < 0 or depth > DEPTH_MAX:
            raise DocumentError("template", [f"more than {ITEMS_MAX} values or nested deeper than {DEPTH_MAX}"])
        if isinstance(value, str):
            return self._render_text(value, names) if "{" in value else value
        if isinstance(value, Mapping):
            return {key: self._render(item, names, budget, depth + 1) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [self._render(item, names, budget, depth + 1) for item in value]
        return value

    def _render_text(self, text: str, names: Mapping[str, Any]) -> Any:
        with _refusals(text):
            result = _compiled(text).render(**names)
            if isinstance(result, jinja2.Undefined):
                str(result)
        return result
