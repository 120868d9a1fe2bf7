"""The platform's chart as a bundle has it: what a user would have to look up stands in its values.yaml."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ci.errors import SetUpError
from ci.images.services import SERVICE_NAMES
from ci.installation import PLATFORM_IMAGES
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.core.packing import PackedChart

VALUES, EMBEDDED = "values.yaml", "values-embedded.yaml"


def bundled_chart(chart: Path, references: Mapping[str, str], keys: Mapping[str, str]) -> PackedChart:
    """The chart in a folder, packed, with image references by digest and the public keys (name -> PEM) that signed the
    evidence of the bundle's charts."""
    with tempfile.TemporaryDirectory(prefix="robotkube-bundle-") as work:
        copy = Path(work) / chart.name
        shutil.copytree(chart, copy)
        text = (copy / VALUES).read_text(encoding="utf-8")
        embedded = yaml.safe_load((copy / EMBEDDED).read_text(encoding="utf-8"))
        (copy / VALUES).write_text(with_defaults(text, defaults(references, keys, embedded)), encoding="utf-8")
        return pack(copy, {}, hidden=True)


def defaults(references: Mapping[str, str], keys: Mapping[str, str], embedded: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a bundle's chart that differ from those of the chart in the repository: images, the database that is
    among them, where the forge's image has its files, and whose signatures count."""
    services = {name: reference for name, reference in references.items() if name in SERVICE_NAMES}
    others = [reference for name, reference in references.items() if name not in (*SERVICE_NAMES, *PLATFORM_IMAGES)]
    return {
        "images": {name: references[name] for name in PLATFORM_IMAGES},
        "serviceImages": services,
        "evidence": {"trustedKeys": dict(keys)},
        "inspection": {"images": sorted(others)},
        "database": {key: embedded["database"][key] for key in ("kind", "arguments")},
        "forge": {"staticRootPath": embedded["forge"]["staticRootPath"]},
    }


def with_defaults(text: str, values: Mapping[str, Mapping[str, Any]]) -> str:
    """values.yaml with other defaults, its comments kept: a line for each key of a block. SetUpError when the file has
    not that form."""
    lines = text.splitlines()
    for block, keys in values.items():
        lines = _block(lines, block, keys)
    written = "\n".join(lines) + "\n"
    expected = _merged(yaml.safe_load(text), values)
    if yaml.safe_load(written) != expected:
        raise SetUpError(
            f"charts/robotkube/{VALUES}: its form changed, so a bundle's defaults cannot be written into it"
        )
    return written


def _block(lines: list[str], block: str, keys: Mapping[str, Any]) -> list[str]:
    place = next((number for number, line in enumerate(lines) if re.match(rf"{block}:", line)), None)
    if place is None:
        raise SetUpError(f"charts/robotkube/{VALUES}: no key {block}")
    if re.match(rf"{block}: *\{{", lines[place]):
        written = yaml.safe_load(lines[place])[block] or {}
        return [*lines[:place], f"{block}: {_flow({**written, **keys})}", *lines[place + 1 :]]
    end = next((n for n in range(place + 1, len(lines)) if re.match(r"\S", lines[n])), len(lines))
    inner = list(lines[place + 1 : end])
    for key, value in keys.items():
        at = next((number for number, line in enumerate(inner) if re.match(rf"  {key}:", line)), None)
        line = f"  {key}: {_flow(value)}"
        inner = [*inner, line] if at is None else [*inner[:at], line, *inner[_after(inner, at) :]]
    return [*lines[: place + 1], *inner, *lines[end:]]


def _after(inner: list[str], at: int) -> int:
    """The number of the line behind the value of the key in line `at`."""
    return next((n for n in range(at + 1, len(inner)) if re.match(r"  [^ -]", inner[n])), len(inner))


def _flow(value: Any) -> str:
    """A value in one line."""
    return str(yaml.safe_dump(value, default_flow_style=True, width=10**6)).removesuffix("...\n").strip()


def _merged(before: Mapping[str, Any], values: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {**before, **{block: {**(before.get(block) or {}), **keys} for block, keys in values.items()}}
