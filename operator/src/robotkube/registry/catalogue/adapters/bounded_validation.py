"""JSON Schemas of strangers, checked where they can do no harm: gate and manager must not stand still for one.

`python3 -m robotkube.registry.catalogue.adapters.bounded_validation` is the process in which they are checked.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters import json_schema as schemas_jsonschema
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.runtime.adapters.bounded_process import BoundedProcess, SentCall, serve
from robotkube.registry.catalogue.core.sources import Path, Tools

COMMAND = (sys.executable, "-m", "robotkube.registry.catalogue.adapters.bounded_validation")
REFUSED_MAX = 1024


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

    def ahead(self) -> ValidationAhead:
        """A validation that takes values for valid until it is asked whether they were."""
        return ValidationAhead(self._process)

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


class Asking(Protocol):
    """BoundedProcess, as far as it is asked here."""

    def ask(self, name: str, subject: Any, *arguments: Any) -> SentCall:
        """Send a call, as BoundedProcess.ask does."""


class ValidationAhead:
    """BoundedSchemas.validate for who would go on while values are checked, and begin again if any were not valid.

    `validate` takes values for valid which it has not refused before, until `settled`: that waits for all answers, and
    says whether what was taken for valid is. After one that was not, values are waited for until `settled` once more.
    Not for several threads.
    """

    def __init__(self, process: Asking) -> None:
        self._process = process
        self._asked: list[SentCall] = []
        self._refused: dict[tuple[int, str], tuple[Mapping[str, Any], Sequence[str]]] = {}
        self._waits = False

    def validate(self, schema: Mapping[str, Any], value: Any, name: str = "parameters", /) -> Sequence[str]:
        """Problems of `value`, as far as they are known."""
        known = self._refused.get((id(schema), json.dumps((value, name)))) if self._refused else None
        if known is not None:
            return known[1]
        asked = self._process.ask("validate", schema, value, name)
        if self._waits:
            return self._problems(asked)
        self._asked.append(asked)
        return []

    def settled(self) -> bool:
        """Return whether everything was valid that was taken for it since the last time."""
        asked, self._asked = self._asked, []
        refused = [one for one in asked if self._problems(one)]
        self._waits = bool(refused)
        return not refused

    def _problems(self, asked: SentCall) -> Sequence[str]:
        try:
            problems: Sequence[str] = asked.result()
        except InputError as error:
            problems = [f"{json.loads(asked.text)[1]}: {error}"]
        if problems:  # kept with the schema, so that nothing else can have its id
            self._refused[id(asked.subject), asked.text] = asked.subject, problems
            if len(self._refused) > REFUSED_MAX:
                self._refused.pop(next(iter(self._refused)))
        return problems


def main() -> None:
    """Answer until the parent ends."""
    functions = ("validate", "check_schema", "violations")
    serve({name: getattr(schemas_jsonschema, name) for name in functions}, sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
