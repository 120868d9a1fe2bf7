"""What the gate's suites cost: the seconds that the evidence kept in the user's cache says, as publications on an
embedded cluster measured them. Goes to build/bench/registry.json as `publish_seconds`.

Nothing is run here: suites need a cluster, and `make demo` has one. Without kept evidence nothing is recorded.
"""

from __future__ import annotations

import base64
import json
import sys
from pathlib import Path

from ci import evidence
from ci.benchmarks.measuring import Figure
from ci.benchmarks.registry import record

SUMMARY = "summary"


def suite_seconds(kept: Path) -> dict[str, float]:
    """Suite -> the longest it took for any chart, of each chart's newest evidence below `kept`."""
    newest: dict[tuple[str, str], Path] = {}
    for path in sorted(kept.glob("evidence/*/*/*.json"), key=lambda one: (one.stat().st_mtime_ns, str(one))):
        newest[path.parent.parent.name, path.stem] = path
    found: dict[str, float] = {}
    for (_, suite), path in newest.items():
        if suite != SUMMARY:
            found[suite] = max(found.get(suite, 0.0), _seconds(path))
    return found


def _seconds(path: Path) -> float:
    """What the statement in an envelope says about its own run."""
    statement = json.loads(base64.b64decode(json.loads(path.read_text(encoding="utf-8"))["payload"]))
    suite = next(one for one in statement["predicate"]["configuration"] if one["name"] == "suite")
    return float(suite["annotations"]["seconds"])


def figures() -> list[Figure]:
    """No ratio: records what was measured, if anything was."""
    found = suite_seconds(evidence.kept_folder())
    if found:
        record({"publish_seconds": found})
    else:
        print("publication: no kept evidence; `make demo` measures publish_seconds", file=sys.stderr)
    return []
