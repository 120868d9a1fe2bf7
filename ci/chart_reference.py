"""`make reference`: what is generated in charts: the event detector's settings in its values.schema.json, from the code
that reads them, and the table of values in the READMEs of the charts below, from schema and values.yaml.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from robotkube.domain.detector_schema import detector_schema

TOP = Path(__file__).resolve().parent.parent
CHARTS = TOP / "charts" / "apps"
SCHEMA = CHARTS / "event-detector" / "values.schema.json"
DESCRIBED = ("event-detector", "mqtt-bridge")
BEGIN, END = "<!-- written by `make reference`: begin -->", "<!-- end -->"
ELSEWHERE = {"detector.rules[]": "docs/reference/rules.md"}
"""Lists whose items have a page of their own."""
SILENT = ("robotkube-app", "global", "resources.")

Schema = Mapping[str, Any]


def schema_text(text: str) -> str:
    """values.schema.json of the event detector with the settings as the code reads them."""
    document = json.loads(text)
    document["properties"]["detector"]["properties"] = detector_schema()
    return json.dumps(document, indent=2) + "\n"


def readme(name: str, text: str) -> str:
    """A chart's README with its table of values anew. ValueError without both marks."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{name}/README.md needs both marks: {BEGIN} and {END}")
    schema = json.loads((CHARTS / name / "values.schema.json").read_text(encoding="utf-8"))
    defaults = yaml.safe_load((CHARTS / name / "values.yaml").read_text(encoding="utf-8"))
    head = ["| value | default | meaning |", "| --- | --- | --- |"]
    lines = [*head, *(_row(*row) for row in _rows(schema, schema, "", defaults))]
    return "\n".join([f"{before}{begin}", *lines, f"{end}{after}"])


def _row(path: str, default: str, meaning: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in (f"`{path}`", default, meaning)) + " |"


def _rows(root: Schema, schema: Schema, path: str, defaults: Any) -> Iterator[tuple[str, str, str]]:
    """Path, default and meaning of everything below, in the order of the schema."""
    for key, found in schema.get("properties", {}).items():
        full = f"{path}.{key}" if path else key
        inner = _resolved(root, found)
        default = defaults.get(key) if isinstance(defaults, Mapping) else inner.get("default")
        if full.startswith(SILENT):
            continue
        if "properties" not in inner:
            yield full, _default(default, inner), _meaning(inner)
        yield from _rows(root, inner, full, defaults.get(key) if isinstance(defaults, Mapping) else None)
        yield from _items(root, inner, full)


def _items(root: Schema, schema: Schema, path: str) -> Iterator[tuple[str, str, str]]:
    items = f"{path}[]"
    if items in ELSEWHERE:
        page = ELSEWHERE[items]
        yield items, "", f"see [{Path(page).name}](../../../{page})"
    elif "items" in schema:
        yield from _rows(root, _resolved(root, schema["items"]), items, None)


def _resolved(root: Schema, schema: Schema) -> Schema:
    reference = schema.get("$ref")
    found: Schema = root["$defs"][reference.removeprefix("#/$defs/")] if reference else schema
    return found


def _default(value: Any, schema: Schema) -> str:
    shown = schema.get("default") if value is None else value
    return "" if shown is None else f"`{json.dumps(shown)}`"


def _meaning(schema: Schema) -> str:
    words = ", ".join(f"`{word}`" for word in schema.get("enum", ()))
    return f"{words}. {schema['description']}" if words else str(schema.get("description", ""))


def write() -> list[Path]:
    """Write everything anew; the files."""
    SCHEMA.write_text(schema_text(SCHEMA.read_text(encoding="utf-8")), encoding="utf-8")
    pages = [CHARTS / name / "README.md" for name in DESCRIBED]
    for page in pages:
        page.write_text(readme(page.parent.name, page.read_text(encoding="utf-8")), encoding="utf-8")
    return [SCHEMA, *pages]
