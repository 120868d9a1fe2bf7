"""Templates of the catalogue: types stay, mistakes are named, nothing grows without bound or reaches outside."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.value_templates import render_templates

RENDER = Jinja2Templates().render
NAMES = {"parameters": {"vehicles": ["vehicle-00", "vehicle-01"], "n": 5, "s": "007"}, "agent": "vehicle-00"}


@pytest.mark.parametrize(
    ("template", "expected"),
    [
        ("{{ parameters.vehicles }}", ["vehicle-00", "vehicle-01"]),
        ("recorder-{{ parameters.vehicles | join('-') }}", "recorder-vehicle-00-vehicle-01"),
        ("/vehicles/{{ agent | ros }}/pose", "/vehicles/vehicle_00/pose"),
        ("{{ parameters.n * 2 }}", 10),
        ("{{ parameters.s }}", "007"),
        ("{{ parameters.s }}{{ parameters.s }}", "007007"),
        ("[{{ parameters.n }}]", "[5]"),
        ("{agents}", "{agents}"),
        ("{{ parameters.missing | default(3) }}", 3),
        ("{{ task.name if task is defined else 'none' }}", "none"),
        ({"a": ["{{ parameters.n }}", None, True, 1.5]}, {"a": [5, None, True, 1.5]}),
    ],
)
def test_templates(template: Any, expected: Any) -> None:
    assert RENDER(template, NAMES) == expected


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{{ nothing }}", "'nothing' is undefined"),
        ("{{ parameters.nothing }}", "has no attribute 'nothing'"),
        ("{{ x", "unexpected end of template"),
        ("{{ 'a' * 99999999 }}", "operator * is not allowed"),
        ("{{ 9 ** 9 ** 9 }}", "operator ** is not allowed"),
        ("{{ 'a%99999999d' % 1 }}", "operator % is not allowed"),
        ("{{ 'x'.ljust(99999999) }}", "Call is not allowed"),
        ("{{ range(9) }}", "Call is not allowed"),
        ("{{ 'ab' | join('ab') }}", "join needs a list"),
        ("{{ ''.__class__ }}", "unsafe"),
        ("{% for v in parameters.vehicles %}{{ v }}{% endfor %}", "For is not allowed"),
        ("{% include 'x' %}", "Include is not allowed"),
        ("{{ parameters.n | replace('a', 'b') }}", "No filter named 'replace'"),
        ("{{ 1 / 0 }}", "division"),
        ("{{ agent }}" + "x" * 5000, "longer than"),
    ],
)
def test_refusals(template: str, text: str) -> None:
    with pytest.raises(DocumentError, match=text.replace("*", r"\*")):
        RENDER(template, NAMES)


def test_loops_in_values() -> None:
    inner = {"forEach": {"w": [1, 2]}, "each": ["{{ v }}/{{ w }}"]}
    value = {"list": ["first", {"forEach": {"v": "{{ parameters.vehicles }}"}, "each": [inner, "{{ v }}"]}]}
    assert render_templates(value, NAMES, RENDER)["list"] == [
        "first", "vehicle-00/1", "vehicle-00/2", "vehicle-00", "vehicle-01/1", "vehicle-01/2", "vehicle-01",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "value",
    [
        [{"forEach": {"v": "{{ parameters.n }}"}, "each": []}],
        [{"forEach": {}, "each": []}],
        [{"forEach": {"v": [1]}, "each": "x"}],
        [{"forEach": {"v": list(range(300))}, "each": []}],
        [{"forEach": {"v": list(range(200))}, "each": [{"forEach": {"w": list(range(200))}, "each": ["x"]}]}],
    ],
)
def test_loops_that_are_refused(value: Any) -> None:
    with pytest.raises(DocumentError):
        render_templates(value, NAMES, RENDER)
