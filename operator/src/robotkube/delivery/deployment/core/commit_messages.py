"""The commit of a plan as text: building the message and reading it back, strictly.

    deploy(recording): vehicle-00, vehicle-01 within 400 m

    RobotKube-Task: cloud-0/pose-point-cloud-proximity-3f2a9c
    RobotKube-Event: 3f2a9c...
    RobotKube-Rule: lidar-proximity
    RobotKube-Trace: <32 hex>
    RobotKube-Plan: 20261121-100000-1a2b3c
    RobotKube-Manager: manager
    RobotKube-Term: 7
    RobotKube-Chart: event-detector@0.1.0@sha256:...
    RobotKube-Evidence: sha256:...

Task, Event, Rule and Trace come once per task, in this order; Evidence once per Chart, in the same order: the digest of
the chart's verification summary, or `none`. What no task asks for has a `RobotKube-Cause` (KINDS) and the plan's id as
its trace; a plan can have both. `revert` and `repair` name the commits that they undo, one `RobotKube-Reverts` each.
Manager is the forge account that proposes, Term the number of its election: a manager's term never falls on main. A
reason that the subject has no room for stands as a paragraph `Reason: ...` before the trailers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from robotkube.delivery.deployment.core.releases import TaskCause
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import COMMIT, DIGEST, EVIDENCE, NAME, PLAN, TASK, TOKEN, VERSION
from robotkube.foundation.forge.core.trailers import named, read_trailer, trailer
from robotkube.registry.charts.core.references import ChartReference

SUBJECT_CHARACTERS_MAX = 100
REASON_CHARACTERS_MAX = 2000
VERBS = ("deploy", "withdraw")
INITIAL = "initial"
NODE = "node"
REPAIR = "repair"
REVERT = "revert"
UPDATE = "update"
KINDS = (INITIAL, NODE, REPAIR, REVERT, UPDATE)
CAUSES_MAX = 100
REVERTS_MAX = 100
TERM_MAX = 2**31 - 1

TERM = re.compile(r"0|[1-9][0-9]{0,9}", re.ASCII)

_SUBJECT = re.compile(rf"(?P<verb>{'|'.join(VERBS)})\((?P<area>{NAME.pattern})\): (?P<reason>\S.*)")
_REASON = "Reason: "
_KEYS = ("Task", "Event", "Rule", "Trace", "Cause", "Reverts", "Plan", "Manager", "Term", "Chart", "Evidence")


@dataclass(frozen=True)
class CommitMessage:
    """What a plan's commit says. `causes` are the tasks (their `application` and `parameters` are not part of the
    text); `kinds` say what else than tasks changes releases (of KINDS, sorted); `charts` are those of the changed
    releases, sorted, and `evidence` goes with them, one word per chart; `manager` and `term` say who proposes, and
    under which election; `reverts` are ids of the commits that it undoes."""

    verb: str
    area: str
    reason: str
    plan: str
    causes: tuple[TaskCause, ...] = ()
    kinds: tuple[str, ...] = ()
    charts: tuple[ChartReference, ...] = ()
    evidence: tuple[str, ...] = ()
    manager: str = ""
    term: int = 0
    reverts: tuple[str, ...] = ()

    @property
    def subject(self) -> str:
        """First line, bounded in length, without control characters."""
        return shorten(f"{self.verb}({self.area}): {one_line(self.reason)}", SUBJECT_CHARACTERS_MAX)

    @property
    def initial(self) -> bool:
        """Return whether the initial configuration changes, as well or alone."""
        return INITIAL in self.kinds

    def signed(self, manager: str, term: int) -> CommitMessage:
        """The same in the name of a manager and its term."""
        return replace(self, manager=manager, term=term)

    @property
    def traces(self) -> tuple[str, ...]:
        """Every trace the commit carries, in order."""
        return tuple(c.trace for c in self.causes) + ((self.plan,) if self.kinds else ())


def one_line(text: str) -> str:
    """`text` with every run of white space and control characters as one space: it cannot forge a trailer."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split()) or "no reason given"


def shorten(text: str, characters_max: int) -> str:
    """`text`, cut with an ellipsis when longer than allowed."""
    return text if len(text) <= characters_max else text[: characters_max - 1].rstrip() + "…"


def write_message(message: CommitMessage) -> str:
    """The whole commit message, ending with a newline."""
    lines: list[tuple[str, str]] = []
    for cause in message.causes:
        lines += [("Task", cause.task), ("Event", cause.event), ("Rule", cause.rule), ("Trace", cause.trace)]
    lines += [("Cause", kind) for kind in message.kinds]
    lines += [("Trace", message.plan)] if message.kinds else []
    lines += [("Reverts", commit) for commit in message.reverts]
    lines += [("Plan", message.plan), ("Manager", message.manager), ("Term", str(message.term))]
    for chart, evidence in zip(message.charts, message.evidence, strict=True):
        lines += [("Chart", str(chart)), ("Evidence", evidence)]
    trailers = [trailer(key, word) for key, word in lines]
    return "\n".join([message.subject, "", *_whole_reason(message), *trailers]) + "\n"


def _whole_reason(message: CommitMessage) -> Sequence[str]:
    """A paragraph with the reason, when the subject has no room for it."""
    reason = shorten(one_line(message.reason), REASON_CHARACTERS_MAX)
    return () if message.subject.endswith(f": {reason}") else (f"{_REASON}{reason}", "")


def read_message(text: str, where: str = "commit message") -> CommitMessage:
    """The message in `text`; DocumentError lists what is missing, doubled, malformed or unknown."""
    subject, _, rest = text.partition("\n")
    problems: list[str] = []
    match = _SUBJECT.fullmatch(subject)
    if not match:
        problems.append(f"subject {subject!r} must be `deploy(<area>): <reason>` or `withdraw(<area>): <reason>`")
    whole, rest = _read_reason(rest)
    trailers = _trailers(rest, problems)
    message = CommitMessage(
        verb=match["verb"] if match else "",
        area=match["area"] if match else "",
        reason=whole or (match["reason"] if match else ""),
        plan=_one(trailers, "Plan", PLAN, problems),
        causes=_causes(trailers, problems),
        kinds=_kinds(trailers, problems),
        charts=_charts(trailers["Chart"], problems),
        evidence=_evidence(trailers, problems),
        manager=_one(trailers, "Manager", TOKEN, problems),
        term=_term(trailers, problems),
        reverts=_reverts(trailers, problems),
    )
    problems += _completeness(message, trailers)
    if whole and message.subject != subject:
        problems.append(f"{_REASON.strip()} {whole!r:.80} does not begin as the subject does")
    if problems:
        raise DocumentError(where, problems)
    return message


def _read_reason(rest: str) -> tuple[str, str]:
    """The paragraph with the whole reason, empty when there is none, and what follows the subject without it."""
    lines = rest.split("\n")
    if len(lines) < 3 or lines[0] or lines[2] or not lines[1].startswith(_REASON):
        return "", rest
    return lines[1].removeprefix(_REASON)[:REASON_CHARACTERS_MAX], "\n".join(lines[2:])


def _trailers(rest: str, problems: list[str]) -> dict[str, list[str]]:
    trailers: dict[str, list[str]] = {key: [] for key in _KEYS}
    lines = rest.rstrip("\n").split("\n")
    if lines and lines[0]:
        problems.append("the line after the subject must be empty")
    for line in lines[1:]:
        key, word = read_trailer(line) or ("", "")
        if key in trailers:
            trailers[key].append(word)
        else:
            problems.append(f"line {line!r} is not one of the trailers {', '.join(map(named, _KEYS))}")
    return trailers


def _one(trailers: dict[str, list[str]], key: str, pattern: re.Pattern[str], problems: list[str]) -> str:
    values = trailers[key]
    if len(values) != 1:
        problems.append(f"RobotKube-{key} must stand exactly once, found {len(values)}")
        return ""
    if not pattern.fullmatch(values[0]):
        problems.append(f"RobotKube-{key}: {values[0]!r} must match {pattern.pattern}")
    return values[0]


def _causes(trailers: dict[str, list[str]], problems: list[str]) -> tuple[TaskCause, ...]:
    counts = {key: len(trailers[key]) for key in ("Task", "Event", "Rule")}
    traces = trailers["Trace"][: counts["Task"]]
    if len(set(counts.values())) > 1 or len(traces) != counts["Task"]:
        problems.append(
            f"every task needs one -Task, -Event, -Rule and -Trace; found {counts}, {len(trailers['Trace'])} traces"
        )
        return ()
    if counts["Task"] > CAUSES_MAX:
        problems.append(f"{counts['Task']} tasks in one plan, at most {CAUSES_MAX} are allowed")
    for key, pattern in (("Task", TASK), ("Event", TOKEN), ("Rule", TOKEN), ("Trace", TOKEN)):
        problems += [
            f"RobotKube-{key}: {v!r} must match {pattern.pattern}" for v in trailers[key] if not pattern.fullmatch(v)
        ]
    rows = zip(trailers["Task"], trailers["Event"], trailers["Rule"], traces, strict=True)
    return tuple(TaskCause(task, event, rule, trace, "") for task, event, rule, trace in rows)


def _kinds(trailers: dict[str, list[str]], problems: list[str]) -> tuple[str, ...]:
    kinds = trailers["Cause"]
    if kinds != sorted(set(kinds) & set(KINDS)):
        problems.append(f"RobotKube-Cause must be one of {', '.join(KINDS)}, each once, sorted; found {kinds}")
    return tuple(kinds)


def _term(trailers: dict[str, list[str]], problems: list[str]) -> int:
    word = _one(trailers, "Term", TERM, problems)
    term = int(word) if TERM.fullmatch(word) else 0
    if term > TERM_MAX:
        problems.append(f"RobotKube-Term: {term} is more than {TERM_MAX}")
    return term


def _reverts(trailers: dict[str, list[str]], problems: list[str]) -> tuple[str, ...]:
    commits = trailers["Reverts"]
    problems += [
        f"RobotKube-Reverts: {word!r} must be a commit of 40 hex" for word in commits if not COMMIT.fullmatch(word)
    ]
    if len(commits) > REVERTS_MAX:
        problems.append(f"{len(commits)} RobotKube-Reverts, at most {REVERTS_MAX} are allowed")
    return tuple(commits)


def _charts(values: Sequence[str], problems: list[str]) -> tuple[ChartReference, ...]:
    charts = []
    for value in values:
        parts = value.split("@")
        if len(parts) == 3 and NAME.fullmatch(parts[0]) and VERSION.fullmatch(parts[1]) and DIGEST.fullmatch(parts[2]):
            charts.append(ChartReference(*parts))
        else:
            problems.append(f"RobotKube-Chart: {value!r} must be name@version@sha256:<64 hex>")
    return tuple(charts)


def _evidence(trailers: dict[str, list[str]], problems: list[str]) -> tuple[str, ...]:
    evidence = trailers["Evidence"]
    charts = trailers["Chart"]
    if len(evidence) != len(charts):
        problems.append(
            f"RobotKube-Evidence must stand once per RobotKube-Chart, found {len(evidence)} of {len(charts)}"
        )
    problems += [
        f"RobotKube-Evidence: {word!r} must be `none` or sha256:<64 hex>"
        for word in evidence
        if not EVIDENCE.fullmatch(word)
    ]
    return tuple(evidence)


def _completeness(message: CommitMessage, trailers: dict[str, list[str]]) -> Iterable[str]:
    if not message.causes and not message.kinds:
        yield "neither a RobotKube-Task nor a RobotKube-Cause: the commit does not say why"
    extra = trailers["Trace"][len(trailers["Task"]) :]
    if message.kinds and message.plan and extra != [message.plan]:
        yield f"RobotKube-Trace of a RobotKube-Cause must be the plan's id {message.plan!r}, found {extra}"
    if not message.kinds and extra:
        yield f"more RobotKube-Trace than tasks: {extra}"
    if not message.charts and REPAIR not in message.kinds:
        yield "RobotKube-Chart is missing: name every chart of the changed releases"
