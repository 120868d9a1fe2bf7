"""Descriptions of rules in words, for people who read why a task was asked for."""

from __future__ import annotations

from robotkube.robots.rules.core.specification.specifications import (
    ALL,
    ANY,
    Absence,
    Always,
    Cel,
    Combination,
    Geofence,
    Level,
    Proximity,
    Python,
    Rate,
    Rule,
    Threshold,
)


def reason(rule: Rule) -> str:
    """The reason for the events of a rule, in words; `{agents}` stands for the agents of an event."""
    match rule.condition:
        case Proximity() as it:
            return f"{{agents}} within {it.start_distance_m:g} m"
        case Geofence() as it:
            return f"{{agents}} {'inside' if it.inside else 'outside'} {rule.name}"
        case Threshold() as it:
            return f"{{agents}}: {it.field} {_level(it.level)}"
        case Rate() as it:
            return f"{{agents}}: {it.topic.text} {_level(it.level)} Hz"
        case Absence() as it:
            return f"{{agents}}: nothing on {it.topic.text} for {it.seconds:g} s"
        case Combination() as it:
            return f"{{agents}}: {_parts(it)}"
        case Cel() as it:
            return f"{{agents}}: {it.expression}"
        case Python() | Always():
            return f"{{agents}}: {rule.name}"


def _level(level: Level) -> str:
    return f"{'above' if level.above else 'below'} {level.start:g}"


def _parts(combination: Combination) -> str:
    names = [f"{'not ' if part.negated else ''}{part.rule}" for part in combination.parts]
    word = {ALL: " and ", ANY: " or "}.get(combination.mode, ", then ")
    return word.join(names)
