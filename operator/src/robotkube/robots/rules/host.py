"""The process of one rule that the detector does not evaluate itself: an expression, or a rule of an installed package.

`python3 -m robotkube.robots.rules.host` answers questions on its standard input; with `check` it checks expressions.
Detectors and `robotkube rule test` use `start_rule` and `check_expressions`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.runtime.adapters import bounded_process
from robotkube.foundation.runtime.adapters.bounded_process import BoundedProcess
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.rules.adapters.child_processes import COMMAND, ChildProcess, serve
from robotkube.robots.rules.core import FALL, KEEP, RISE, Cause, Cel, Python, Rule, RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.plugin_api import ENTRY_POINT_GROUP, PluginHost
from robotkube.robots.rules.core.specification.expressions import NamedExpression

CHECK_COMMAND = (*COMMAND, "check")

Answering = Callable[[RuleQuestion], Sequence[RuleAnswer]]


def start_rule(rule: Rule, types: Mapping[str, str], lookup: Callable[[str], str]) -> ChildProcess:
    """Start the process of a rule of kind cel or python. `types`: topic pattern -> type; `lookup`: type -> its
    definition."""
    settings = rule.condition
    if isinstance(settings, Cel):
        expression = {"kind": rule.kind, "expression": settings.expression, "until": settings.until}
        return ChildProcess(expression, settings.budget_seconds)
    assert isinstance(settings, Python)
    topics = {topic.text: types[topic.text] for topic in settings.topics}
    job: dict[str, Any] = {
        "kind": rule.kind,
        "plugin": settings.plugin,
        "settings": dict(settings.settings),
        "buffer_seconds": settings.buffer_seconds,
        "topics": topics,
        "definitions": _definitions(topics.values(), lookup),
    }
    return ChildProcess(job, settings.budget_seconds)


def check_expressions(expressions: Sequence[NamedExpression]) -> Sequence[str]:
    """The problem of each of these expressions, `""` when there is none; by a process of its own, which takes 1 s."""
    process = BoundedProcess(CHECK_COMMAND)
    try:
        return [_problem_from(process, expression) for expression in expressions]
    finally:
        process.close()


def _problem_from(process: BoundedProcess, expression: NamedExpression) -> str:
    try:
        return str(process.call("problem", list(expression)))
    except InputError:  # more time or memory than a check may take
        return "takes too long to be evaluated; make it simpler"


def main() -> None:
    """Answer questions until the parent ends."""
    if sys.argv[1:] == ["check"]:
        bounded_process.serve({"problem": _problem}, sys.stdin.buffer, sys.stdout.buffer)
    else:
        serve(_load)


def _problem(checked: NamedExpression) -> str:
    from robotkube.robots.rules.adapters.cel import Expression

    text, names = checked
    try:
        return Expression(text).unknown(names)
    except ValueError as error:
        return str(error)


def _definitions(types: Any, lookup: Callable[[str], str]) -> Mapping[str, str]:
    """The definitions of the types that are known here; of others the rule gets the bytes, but no fields."""
    definitions = {}
    for type_name in types:
        try:
            definitions[type_name] = lookup(type_name)
        except KeyError:
            continue
    return definitions


def _load(job: Mapping[str, Any]) -> Answering:
    return _expression(job) if job["kind"] == "cel" else _plugin(job)


def _expression(job: Mapping[str, Any]) -> Answering:
    from robotkube.robots.rules.adapters.cel import Expression

    start = Expression(job["expression"])
    until = Expression(job["until"]) if job["until"] else None

    def judged(values: Mapping[str, Any]) -> int:
        try:
            if start.holds(values):
                return RISE
            return FALL if until is None or until.holds(values) else KEEP
        except ValueError:
            if _measured(values):
                raise
            return KEEP  # CEL compares nothing with what is no number, which is how a sensor says that it knows nothing

    def answer(question: RuleQuestion) -> Sequence[RuleAnswer]:
        verdict = judged(question.values)
        numbers = {key: float(v) for key, v in question.values.items() if isinstance(v, (int, float))}
        return [
            RuleAnswer(question.member, verdict, numbers, (Cause(question.topic, question.stamp, question.values),))
        ]

    return answer


def _measured(value: Any) -> bool:
    """Return whether none of the numbers is NaN."""
    if isinstance(value, (Mapping, list, tuple)):
        return all(map(_measured, value.values() if isinstance(value, Mapping) else value))
    return not (isinstance(value, float) and math.isnan(value))


def _plugin(job: Mapping[str, Any]) -> Answering:
    points = entry_points(group=ENTRY_POINT_GROUP, name=job["plugin"])
    if not points:
        raise LookupError(f"no installed package offers the rule {job['plugin']}")
    rule = next(iter(points)).load()(job["settings"])

    def lookup(type_name: str) -> str:
        return str(job["definitions"][type_name])

    return PluginHost(rule, job["topics"], Layouts(lookup), job["buffer_seconds"]).answer


if __name__ == "__main__":
    main()
