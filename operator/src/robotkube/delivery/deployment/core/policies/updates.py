"""policies/updates.yaml: how a new version of a chart reaches the releases that run an older one.

    default: {canary: true, first: [], successSeconds: 30, failureSeconds: 300, threshold: 1.0, revert: true}
    charts:
      object-detection: {first: [vehicle-02], successSeconds: 60}
    applications:
      environment-perception: {canary: false}

A rule of a chart comes before that of an application, both before the default; a key that a rule leaves out is the
default's. People write it; changing the file also allows digests again that were reverted before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

PATH = "policies/updates.yaml"
SECONDS_MAX = 86_400
FIRST_MAX = 256
_KEYS = ("canary", "first", "successSeconds", "failureSeconds", "threshold", "revert")


@dataclass(frozen=True)
class UpdateRule:
    """The rule of an update. `canary`: one agent first where several have the chart, one of the namespaces `first`
    rather than another. An updated release has succeeded when it was observed healthy for `success_seconds`, and failed
    when it is degraded, or not healthy `failure_seconds` after its update. The update has failed when less than the
    share `threshold` (0 to 1) of the updated releases is left; `revert`: then it is reverted."""

    canary: bool = True
    success_seconds: int = 30
    failure_seconds: int = 300
    threshold: float = 1.0
    revert: bool = True
    first: tuple[str, ...] = ()


@dataclass(frozen=True)
class UpdatePolicy:
    """The content of policies/updates.yaml: rules by chart and by application."""

    default: UpdateRule = UpdateRule()
    charts: Mapping[str, UpdateRule] = field(default_factory=dict)
    applications: Mapping[str, UpdateRule] = field(default_factory=dict)

    def rule(self, release: Release) -> tuple[str, UpdateRule]:
        """The rule for a release, and its name."""
        if release.chart in self.charts:
            return f"charts.{release.chart}", self.charts[release.chart]
        for application in sorted({cause.application for cause in release.causes}):
            if application in self.applications:
                return f"applications.{application}", self.applications[application]
        return "default", self.default


def read_update_policy(text: str, path: str = PATH) -> UpdatePolicy:
    """The policy in `text`; DocumentError names every problem."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["default", "charts", "applications"])
    default = _rule(reader, document.get("default", {}), "default", UpdateRule())
    rules = {kind: _rules(reader, document.get(kind, {}), kind, default) for kind in ("charts", "applications")}
    reader.finish()
    return UpdatePolicy(default, rules["charts"], rules["applications"])


def _rules(reader: Reader, value: Any, path: str, default: UpdateRule) -> dict[str, UpdateRule]:
    if not isinstance(value, Mapping):
        reader.problems.append(f"{path}: must be a mapping")
        return {}
    for name in value:
        reader.text(str(name), path, NAME)
    return {str(name): _rule(reader, item, f"{path}.{name}", default) for name, item in value.items()}


def _rule(reader: Reader, value: Any, path: str, default: UpdateRule) -> UpdateRule:
    rule = reader.mapping(value, path, [], _KEYS)
    return UpdateRule(
        canary=_flag(reader, rule.get("canary", default.canary), f"{path}.canary"),
        success_seconds=_seconds(reader, rule.get("successSeconds", default.success_seconds), f"{path}.successSeconds"),
        failure_seconds=_seconds(reader, rule.get("failureSeconds", default.failure_seconds), f"{path}.failureSeconds"),
        threshold=_share(reader, rule.get("threshold", default.threshold), f"{path}.threshold"),
        revert=_flag(reader, rule.get("revert", default.revert), f"{path}.revert"),
        first=_first(reader, rule.get("first", list(default.first)), f"{path}.first"),
    )


def _first(reader: Reader, value: Any, path: str) -> tuple[str, ...]:
    names = reader.sequence(value, path)
    if len(names) > FIRST_MAX:
        reader.problems.append(f"{path}: names {len(names)} agents; at most {FIRST_MAX}")
    read = [reader.text(name, path, NAME) for name in names[:FIRST_MAX]]
    return tuple(name for name in read if name)


def _flag(reader: Reader, value: Any, path: str) -> bool:
    if not isinstance(value, bool):
        reader.problems.append(f"{path}: must be true or false")
    return value is True


def _seconds(reader: Reader, value: Any, path: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= SECONDS_MAX:
        reader.problems.append(f"{path}: must be a whole number from 1 to {SECONDS_MAX}")
        return 1
    return int(value)


def _share(reader: Reader, value: Any, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value <= 1:
        reader.problems.append(f"{path}: must be a number above 0, at most 1")
        return 1.0
    return float(value)
