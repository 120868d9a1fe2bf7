"""JSON Schemas of strangers, checked where they can do no harm: gate and manager must not stand still for one.

`python3 -m robotkube.registry.catalogue.adapters.bounded_validation` is the process in which they are checked.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters import json_schema as schemas_jsonschema
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.runtime.adapters.bounded_process import BoundedProcess, serve
from robotkube.registry.catalogue.core.sources import Path, Tools

COMMAND = (sys.executable, "-m", "robotkube.registry.catalogue.adapters.bounded_validation")


class BoundedSchemas:
    """The functions of `schemas_jsonschema`, each call bounded in time and memory; `close` ends the process."""

    def __init__(self) -> None:
        self._process = BoundedProcess(COMMAND)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def validate(self, schema: Mapping[str, Any], value: Any, name: str = "parameters", /) -> Sequence[str]:
        """Problems of `value`; that it cannot be checked within the bounds is one."""
        try:
            return self._validate(schema, value, name)
        except InputError as error:
            return [f"{name}: {error}"]

    def tools(self) -> Tools:
        """What validation of sources needs. A schema that cannot be checked within the bounds is an InputError: one is
        asked thousands of times."""
        templates = Jinja2Templates()
        return Tools(templates.render, templates.references, self._check_schema, self._validate, self._violations)

    def _validate(self, schema: Mapping[str, Any], value: Any, name: str = "parameters") -> Sequence[str]:
        problems: list[str] = self._process.call("validate", schema, value, name)
        return problems

    def _check_schema(self, schema: Mapping[str, Any]) -> Sequence[str]:
        problems: list[str] = self._process.call("check_schema", schema)
        return problems

    def _violations(self, schema: Mapping[str, Any], value: Any) -> Sequence[tuple[Path, str]]:
        return [(tuple(path), message) for path, message in self._process.call("violations", schema, value)]


def main() -> None:
    """Answer until the parent ends."""
    functions = ("validate", "check_schema", "violations")
    serve({name: getattr(schemas_jsonschema, name) for name in functions}, sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
