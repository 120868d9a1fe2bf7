"""JSON Schemas of strangers, checked where they can do no harm: gate and manager must not stand still for one.

`python3 -m robotkube.entrypoints.bounded_schemas` is the process in which they are checked.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.adapters import schemas_jsonschema
from robotkube.adapters.bounded_process import BoundedProcess, serve
from robotkube.adapters.templates_jinja2 import Jinja2Templates
from robotkube.domain.errors import InputError
from robotkube.domain.registry_sources import Path, Tools

COMMAND = (sys.executable, "-m", "robotkube.entrypoints.bounded_schemas")


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
        found: list[str] = self._process.call("validate", schema, value, name)
        return found

    def _check_schema(self, schema: Mapping[str, Any]) -> Sequence[str]:
        found: list[str] = self._process.call("check_schema", schema)
        return found

    def _violations(self, schema: Mapping[str, Any], value: Any) -> Sequence[tuple[Path, str]]:
        return [(tuple(path), message) for path, message in self._process.call("violations", schema, value)]


def main() -> None:
    """Answer until the parent ends."""
    functions = ("validate", "check_schema", "violations")
    serve({name: getattr(schemas_jsonschema, name) for name in functions}, sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
