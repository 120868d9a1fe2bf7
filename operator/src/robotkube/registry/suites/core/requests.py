"""What the gate asks of the suite-runner and what it answers, and the JSON forms of both, read strictly.

PUT /runs/<key>   request -> progress; the same key again asks for the same run
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.patterns import (
    ATTEMPT,
    DIGEST,
    IMAGE_BY_DIGEST,
    NAME,
    PLATFORM,
    REPOSITORY,
    SUITE_NAME,
    SUITE_VERSION,
    VERSION,
)
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.registry.evidence.core.statements import Artefact, Check, SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule

KEY_CHARACTERS = 32
CHECKS_MAX = 200
TEXT_CHARACTERS_MAX = 8_000
NAME_CHARACTERS_MAX = 200
SECONDS_MAX = 3_600
COMMAND_WORDS_MAX = 50
SOAK_KEYS = ("soak_seconds", "memory_growth_percent")
STATUSES = ("queued", "running", "finished")
OUTCOMES = ("passed", "failed", "unfinished")


@dataclass(frozen=True)
class Replaced:
    """The published version that an upgrade starts from: its artefact, its repository (`verified/<chart>`) and its
    ChartVersion document."""

    artefact: Artefact
    repository: str
    entry: Mapping[str, Any]


@dataclass(frozen=True)
class SuiteRequest:
    """Run one suite on one artefact. `repository` is `staging/<chart>`, `entry` the ChartVersion document that was
    submitted, `replaced` the version it replaces when that one is published; `attempt` names the submission (its
    commit): a finished run that did not pass is run again for another attempt, it is not part of the key."""

    artefact: Artefact
    repository: str
    policy_digest: str
    rule: SuiteRule
    entry: Mapping[str, Any]
    replaced: Replaced | None = None
    attempt: str = ""

    @property
    def key(self) -> str:
        """Equal for equal digest, policy, suite and suite version, and for nothing else."""
        parts = [self.artefact.digest, self.policy_digest, self.rule.name, self.rule.version]
        return hashlib.sha256(canonical_json(parts)).hexdigest()[:KEY_CHARACTERS]


@dataclass(frozen=True)
class SuiteProgress:
    """The state of a run: `status` is queued, running or finished; `result` is there when it is finished; `reason`
    says what a queued one waits for."""

    status: str
    result: SuiteResult | None = None
    reason: str = ""

    @property
    def finished(self) -> bool:
        """Return whether there is a result."""
        return self.status == "finished"


@dataclass(frozen=True)
class TestSet:
    """Test values of a chart with its templates filled: what is made before the install, and the values.

    `prepare_image` is a name of the chart's images, empty when nothing is run before; ConfigMaps by name."""

    __test__ = False  # not a test of pytest

    name: str
    values: Mapping[str, Any]
    prepare_image: str = ""
    prepare_command: tuple[str, ...] = ()
    config_maps: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def request_document(request: SuiteRequest) -> dict[str, Any]:
    """The request as JSON."""
    return {
        "artefact": _artefact_document(request.artefact),
        "repository": request.repository,
        "policy": request.policy_digest,
        "rule": {**vars(request.rule), "command": list(request.rule.command)},
        "entry": request.entry,
        "replaced": _replaced_document(request.replaced),
        "attempt": request.attempt,
    }


def _artefact_document(artefact: Artefact) -> dict[str, Any]:
    names = ("chart", "version", "digest", "platform")
    return {name: getattr(artefact, name) for name in names}


def _replaced_document(replaced: Replaced | None) -> dict[str, Any] | None:
    if replaced is None:
        return None
    return {
        "artefact": _artefact_document(replaced.artefact),
        "repository": replaced.repository,
        "entry": replaced.entry,
    }


def progress_document(progress: SuiteProgress) -> dict[str, Any]:
    """The progress as JSON."""
    result = progress.result
    return {
        "status": progress.status,
        "reason": progress.reason,
        "result": None if result is None else {**vars(result), "checks": [vars(check) for check in result.checks]},
    }


def read_request(document: Any) -> SuiteRequest:
    """The request in a decoded JSON body; DocumentError names every problem."""
    reader = Reader("suite request")
    keys = ["artefact", "repository", "policy", "rule", "entry", "attempt"]
    root = reader.mapping(document, "", keys, ["replaced"])
    request = SuiteRequest(
        artefact=_artefact(reader, root.get("artefact"), "artefact"),
        repository=reader.word(root.get("repository"), "repository", REPOSITORY),
        policy_digest=reader.word(root.get("policy"), "policy", DIGEST),
        rule=_rule(reader, root.get("rule")),
        entry=_free_mapping(reader, root.get("entry"), "entry"),
        replaced=_replaced(reader, root.get("replaced")),
        attempt=reader.text(root.get("attempt"), "attempt", ATTEMPT),
    )
    reader.finish()
    return request


def _artefact(reader: Reader, value: Any, path: str) -> Artefact:
    artefact = reader.mapping(value, path, ["chart", "version", "digest", "platform"])
    return Artefact(
        chart=reader.word(artefact.get("chart"), f"{path}.chart", NAME),
        version=reader.word(artefact.get("version"), f"{path}.version", VERSION),
        digest=reader.word(artefact.get("digest"), f"{path}.digest", DIGEST),
        platform=reader.word(artefact.get("platform"), f"{path}.platform", PLATFORM),
    )


def _rule(reader: Reader, value: Any) -> SuiteRule:
    rule = reader.mapping(value, "rule", ["name", "version", "seconds"], ["image", "command", "installs", *SOAK_KEYS])
    words = reader.sequence(rule.get("command"), "rule.command")
    if len(words) > COMMAND_WORDS_MAX or not all(isinstance(word, str) for word in words):
        reader.problems.append(f"rule.command: must be a list of at most {COMMAND_WORDS_MAX} texts")
        words = []
    if not isinstance(rule.get("installs", False), bool):
        reader.problems.append("rule.installs: must be true or false")
    return SuiteRule(
        name=reader.word(rule.get("name"), "rule.name", SUITE_NAME),
        version=reader.word(rule.get("version"), "rule.version", SUITE_VERSION),
        seconds=int(_number(reader, rule.get("seconds"), "rule.seconds")),
        image=reader.word(rule.get("image") or None, "rule.image", IMAGE_BY_DIGEST, default=""),
        command=tuple(words),
        installs=rule.get("installs", False) is True,
        soak_seconds=int(_number(reader, rule.get("soak_seconds", 0), "rule.soak_seconds")),
        memory_growth_percent=int(_number(reader, rule.get("memory_growth_percent", 0), "rule.memory_growth_percent")),
    )


def _replaced(reader: Reader, value: Any) -> Replaced | None:
    if value is None:
        return None
    replaced = reader.mapping(value, "replaced", ["artefact", "repository", "entry"])
    return Replaced(
        _artefact(reader, replaced.get("artefact"), "replaced.artefact"),
        reader.word(replaced.get("repository"), "replaced.repository", REPOSITORY),
        _free_mapping(reader, replaced.get("entry"), "replaced.entry"),
    )


def _free_mapping(reader: Reader, value: Any, path: str) -> Mapping[str, Any]:
    if isinstance(value, Mapping):
        return value
    reader.problems.append(f"{path}: must be a mapping")
    return {}


def _number(reader: Reader, value: Any, path: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= SECONDS_MAX:
        return value
    reader.problems.append(f"{path}: must be a number from 0 to {SECONDS_MAX}")
    return 0.0


def read_progress(document: Any) -> SuiteProgress:
    """The progress in a decoded JSON answer; DocumentError names every problem."""
    reader = Reader("suite progress")
    root = reader.mapping(document, "", ["status", "result", "reason"])
    status = _one_of(reader, root.get("status"), "status", STATUSES)
    result = None if root.get("result") is None else _result(reader, root["result"])
    if (status == "finished") != (result is not None):
        reader.problems.append("result: must be there when, and only when, the status is finished")
    reason = _bounded(reader.prose(root.get("reason"), "reason"))
    reader.finish()
    return SuiteProgress(status, result, reason)


def _result(reader: Reader, value: Any) -> SuiteResult:
    result = reader.mapping(value, "result", ["suite", "version", "outcome", "checks", "seconds"])
    return SuiteResult(
        suite=reader.word(result.get("suite"), "result.suite", SUITE_NAME),
        version=reader.word(result.get("version"), "result.version", SUITE_VERSION),
        outcome=_one_of(reader, result.get("outcome"), "result.outcome", OUTCOMES),  # type: ignore[arg-type]
        checks=read_checks(reader, result.get("checks"), "result.checks"),
        seconds=_number(reader, result.get("seconds"), "result.seconds"),
    )


def read_checks(reader: Reader, value: Any, path: str) -> tuple[Check, ...]:
    """A list of checks `{name, passed, found?, fix?}`, at most CHECKS_MAX, names all different."""
    items = reader.sequence(value, path)
    if len(items) > CHECKS_MAX:
        reader.problems.append(f"{path}: more than {CHECKS_MAX} checks")
        items = []
    checks = tuple(_check(reader, item, f"{path}[{index}]") for index, item in enumerate(items))
    names = [check.name for check in checks]
    doubled = sorted({name for name in names if name and names.count(name) > 1})
    reader.problems += [f"{path}: two checks named {name!r}; name each once" for name in doubled]
    return checks


def tidy(checks: Sequence[Check]) -> tuple[Check, ...]:
    """The checks as a result may hold them: names once (a second one is numbered), texts within their bounds."""
    seen: dict[str, int] = {}
    tidied = []
    for check in checks[:CHECKS_MAX]:
        name = " ".join(check.name.split())[: NAME_CHARACTERS_MAX - 8] or "check"
        seen[name] = seen.get(name, 0) + 1
        name = name if seen[name] == 1 else f"{name} ({seen[name]})"
        tidied.append(Check(name, check.passed, _bounded(check.found), _bounded(check.fix)))
    return tuple(tidied)


def _check(reader: Reader, value: Any, path: str) -> Check:
    check = reader.mapping(value, path, ["name", "passed"], ["found", "fix"])
    name = reader.prose(check.get("name"), f"{path}.name")
    if not 0 < len(name) <= NAME_CHARACTERS_MAX:
        reader.problems.append(f"{path}.name: must have 1 to {NAME_CHARACTERS_MAX} characters")
    if not isinstance(check.get("passed"), bool):
        reader.problems.append(f"{path}.passed: must be true or false")
    texts = [_bounded(reader.prose(check.get(key, ""), f"{path}.{key}")) for key in ("found", "fix")]
    return Check(name, check.get("passed") is True, *texts)


def _bounded(text: str) -> str:
    return shortened(text, TEXT_CHARACTERS_MAX)


def _one_of(reader: Reader, value: Any, path: str, known: tuple[str, ...]) -> str:
    if value not in known:
        reader.problems.append(f"{path}: must be one of {', '.join(known)}")
        return known[-1]
    return str(value)
