"""`make reference`: what is generated in charts: the event detector's settings in its values.schema.json, from the code
that reads them, and the table of values in the README of every chart but those in charts/earlier, from schema and
values.yaml. What stands outside the marks is written by people and stays.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ci.docs import markdown
from ci.folders import PROJECT
from robotkube.robots.detector.core.settings_schema import detector_schema

CHARTS = PROJECT / "charts"
SCHEMA = CHARTS / "apps" / "event-detector" / "values.schema.json"
DESCRIBED = ("robotkube", *sorted(f"apps/{path.parent.name}" for path in CHARTS.glob("apps/*/Chart.yaml")))
BEGIN, END = "<!-- written by `make reference`: begin -->", "<!-- end -->"
ELSEWHERE = {"detector.rules[]": "docs/reference/rules.md"}
"""Lists whose items have a page of their own."""
SILENT = ("robotkube-app", "global.plan")
VALUES_HEAD = ("| value | default | meaning |", "| --- | --- | --- |")
UP = "<top>/"
FORMS_HEAD = ("", "Forms that several values share:", "", "| form | meaning |", "| --- | --- |")

DEFINITIONS = "#/$defs/"
COMMON_PARTS = 4
"""As many parts must have a value alike for it to stand once."""

Schema = Mapping[str, Any]
Row = tuple[str, str, str]
"""Path, default and meaning of a value."""


def schema_text(text: str) -> str:
    """values.schema.json of the event detector with the settings as the code reads them."""
    document = json.loads(text)
    document["properties"]["detector"]["properties"] = detector_schema()
    return json.dumps(document, indent=2) + "\n"


def readme(name: str, text: str) -> str:
    """The README of the chart in this folder of charts, with its values anew. ValueError without both marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{name}/README.md needs both marks: {BEGIN} and {END}")
    return markdown.wrapped("\n".join([f"{before}{begin}", *_values(CHARTS / name), f"{end}{after}"]))


def _values(chart: Path) -> list[str]:
    if not (chart / "values.schema.json").exists():
        return ["It has no values of its own."]
    schema = json.loads((chart / "values.schema.json").read_text(encoding="utf-8"))
    defaults = yaml.safe_load((chart / "values.yaml").read_text(encoding="utf-8"))
    up = "../" * len(chart.relative_to(PROJECT).parts)
    rows = list(_rows(schema, schema, "", defaults))
    common = _common(rows)
    lines = [*VALUES_HEAD, *(_row(f"`{path}`", *cells) for path, *cells in rows if path not in common)]
    lines += [*_common_table(rows, common), *_forms_table(schema)]
    return [line.replace(UP, up) for line in lines]


def _common(rows: Sequence[Row]) -> Mapping[str, str]:
    """The values without a default that many parts have alike: path -> part."""
    parts: dict[tuple[str, str], list[str]] = {}
    for path, default, meaning in rows:
        part, _, key = path.rpartition(".")
        parts.setdefault((key, meaning if not default else path), []).append(part)
    return {f"{part}.{key}": part for (key, _), same in parts.items() if len(same) >= COMMON_PARTS for part in same}


def _common_table(rows: Sequence[Row], common: Mapping[str, str]) -> list[str]:
    if not common:
        return []
    keys = {path.rpartition(".")[2]: meaning for path, _, meaning in rows if path in common}
    parts = ", ".join(f"`{part}`" for part in dict.fromkeys(common.values()))
    head = ["", f"Each of {parts} takes, besides:", "", "| value | meaning |", "| --- | --- |"]
    return [*head, *(_row(f"`{key}`", meaning) for key, meaning in keys.items())]


def _forms_table(schema: Schema) -> list[str]:
    """The keys of forms that values refer to."""
    rows = [
        row
        for name, form in schema.get("$defs", {}).items()
        if name in _references(schema)
        for row in (*_rows(schema, form, name, None), *_items(schema, form, name, None))
    ]
    return [*(FORMS_HEAD if rows else ()), *(_row(f"`{path}`", meaning) for path, _, meaning in rows)]


def _references(schema: Any) -> set[str]:
    """The definitions that keys are, and not the items of lists."""
    if not isinstance(schema, Mapping):
        return set()
    own = {str(one["$ref"]).removeprefix(DEFINITIONS) for one in schema.get("properties", {}).values() if "$ref" in one}
    inner = (schema.get("items"), *schema.get("properties", {}).values(), *schema.get("$defs", {}).values())
    return own.union(*(_references(part) for part in inner))


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _rows(root: Schema, schema: Schema, path: str, defaults: Any) -> Iterator[Row]:
    """Path, default and meaning of everything below, in the order of the schema."""
    for key, stated in schema.get("properties", {}).items():
        full = f"{path}.{key}" if path else key
        inner = _resolved(root, stated)
        own = defaults.get(key) if isinstance(defaults, Mapping) else None
        default = own if isinstance(defaults, Mapping) and key in defaults else inner.get("default")
        if full.startswith(SILENT):
            continue
        if "properties" not in inner or "$ref" in stated:
            yield full, _default(default, inner), _meaning({**inner, **stated})
        if "$ref" not in stated:
            yield from _rows(root, inner, full, own)
            yield from _items(root, inner, full, own)


def _items(root: Schema, schema: Schema, path: str, defaults: Any) -> Iterator[Row]:
    """What stands in the items of a list; their defaults are those of the first item that values.yaml has."""
    items = f"{path}[]"
    if items in ELSEWHERE:
        page = ELSEWHERE[items]
        yield items, "", f"see [{Path(page).name}]({UP}{page})"
    elif "items" in schema:
        first = defaults[0] if defaults else None
        yield from _rows(root, _resolved(root, schema["items"]), items, first)


def _resolved(root: Schema, schema: Schema) -> Schema:
    reference = schema.get("$ref")
    definition: Schema = root["$defs"][reference.removeprefix(DEFINITIONS)] if reference else schema
    return definition


def _default(value: Any, schema: Schema) -> str:
    """The default as JSON. Of a list whose items have keys the keys' own defaults say it."""
    shown = schema.get("default") if value is None else value
    if isinstance(shown, list) and any(isinstance(item, Mapping) for item in shown):
        return ""
    return "" if shown is None else f"`{json.dumps(shown)}`"


def _meaning(schema: Schema) -> str:
    words = ", ".join(f"`{word}`" for word in schema.get("enum", ()))
    return f"{words}. {schema['description']}" if words else str(schema.get("description", ""))


def write() -> list[Path]:
    """Write everything anew; the files."""
    SCHEMA.write_text(schema_text(SCHEMA.read_text(encoding="utf-8")), encoding="utf-8")
    pages = [CHARTS / name / "README.md" for name in DESCRIBED]
    for page in pages:
        name = str(page.parent.relative_to(CHARTS))
        page.write_text(readme(name, page.read_text(encoding="utf-8")), encoding="utf-8")
    return [SCHEMA, *pages]
