"""What `robotkube registry submit --watch` writes: a line for each result as it comes, the verdict last."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TextIO

from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.registry.publication.core.report_results import ReportedResult


class ResultLines:
    """Writes to `stream`, at once: a line for people, a JSON document per line, or YAML documents. `now` is the time as
    RFC 3339; a result without a time of its own gets it."""

    def __init__(self, form: str, stream: TextIO, now: Callable[[], str]) -> None:
        self._form = form
        self._stream = stream
        self._now = now

    def result(self, result: ReportedResult) -> None:
        """Write how a suite ended."""
        document = {
            "time": result.ended or self._now(),
            "chart": result.chart,
            "suite": result.suite,
            "result": result.result,
            "seconds": result.seconds,
            "failed": list(result.checks),
        }
        seconds = "-" if result.seconds is None else f"{result.seconds:.1f} s"
        self._write(document, (result.chart, result.suite, result.result, seconds, ", ".join(result.checks)))

    def verdict(self, verdict: str, url: str) -> None:
        """Write how the submission ended; `url` is that of its pull request, empty when there is none."""
        self._write({"time": self._now(), "pull_request": url, "result": verdict}, (url or "-", verdict))

    def _write(self, document: dict[str, Any], words: tuple[str, ...]) -> None:
        if self._form == "json":
            text = json.dumps(document, sort_keys=True)
        elif self._form == "yaml":
            text = f"---\n{write_mapping(document)}".rstrip("\n")
        else:
            text = "  ".join([document["time"], *words]).rstrip()
        self._stream.write(f"{text}\n")
        self._stream.flush()
