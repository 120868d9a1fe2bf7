"""docs/reference/rules.md: every key of every kind of rule, from the schema of `robotkube.robots.rules.core`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ci.docs import markdown
from ci.folders import PROJECT
from robotkube.robots.ros.core.source_clocks import CALM_NS, DISORDER_NS_MAX
from robotkube.robots.rules.core import evaluators
from robotkube.robots.rules.core.combination_feed import HELD_NS_MAX
from robotkube.robots.rules.core.conditions.levels import GRACE_NS
from robotkube.robots.rules.core.specification import consistency
from robotkube.robots.rules.core.specification.json_schema import COMMON, KINDS, PROPERTIES, SCOPED, WATCHING, Kind
from robotkube.robots.rules.loops.workers import QUESTIONS_MAX as WAITING
from robotkube.robots.rules.loops.workers import RETRY_SECONDS_FIRST as FIRST
from robotkube.robots.rules.loops.workers import RETRY_SECONDS_MAX as MOST

PAGE = PROJECT / "docs" / "reference" / "rules.md"
HEAD = """# Rules

Written by `make reference` from the schema in the code; a test says when this page is not current. A rule is an entry
of `rules` in the event detector's `config.yaml`. Unknown keys are refused, and all problems of a document are reported
at once, each with its key and what to do. How to write one: [write a rule](../how-to/write-a-rule.md).
"""
TEXT = f"""## Events

A rule raises an event for an agent, for two of them, or for a group, at its **start edge**, and ends it at its **stop
edge**. Both carry the event's `id`, which is made of the rule, the agents and the stamp of the start: the same messages
give the same event, live and from a bag. An edge knows its causes: the messages and the values that were compared.

- **Time** is the messages' own stamp (header, else reception), as far as the topic's buffer believes it: what the
  buffer refuses is a sign of life and nothing else, and where its time begins anew (a simulation, a bag in a loop), so
  does the agent's ([buffer and time](../explanation/buffer-and-time.md)).
- **Disorder**: messages that come out of order are put in order first, for which all rules wait, at most
  {DISORDER_NS_MAX / 1e9:g} s and until {CALM_NS / 1e9:g} s after the last one. What comes later than that is not
  evaluated.
- **What shows itself by silence** (an absence, the end of a sustained time, an agent that is gone) is reported at most
  {GRACE_NS / 1e9:g} s after its moment, because the message that says otherwise may be under way. Its stamp is that
  moment. A combination waits for it, at most {HELD_NS_MAX / 1e9:g} s, before it follows what another part says of a
  later one.
- **Order**: `sustained_seconds`, `minimum_interval_seconds` and `cooldown_seconds` each put the start off; it comes
  when all have passed, if the condition still holds.
- **Scope**: of `agent` each agent has its own event (a topic without `{{agent}}` is the detector's own agent's), of
  `pair` each two of them, of `group` all of `agents` together one, while it holds for `at_least` of them. A group that
  lists no `agents` is whoever is heard of: its event has the agents for whom it holds when it begins.
- **Silence**: an agent that sends nothing for `expire_seconds` has no event any more; the stop edge's stamp is
  the end of that time.
- **Bounds**: {evaluators.AGENTS_MAX} agents per rule; at most {consistency.WORKERS_MAX} rules of kinds cel and python.
  Each of these has a process of its own; {WAITING} messages wait for it, more are dropped and counted. A rule that
  fails, takes longer than its budget or does not answer is suspended, named in `/status`, and tried again after
  {FIRST:g} s, then twice as long each time, at most {MOST:g} s; the others go on.
"""


def page() -> str:
    """The whole page."""
    lines = [HEAD, TEXT, *_common(), *(line for name in KINDS for line in _kind(name, KINDS[name]))]
    return markdown.wrapped("\n".join(lines).rstrip() + "\n")


def _common() -> Iterator[str]:
    yield "## Keys of all kinds\n"
    watching = ", ".join(name for name, kind in KINDS.items() if set(WATCHING) <= set(kind.keys))
    yield f"`{'`, `'.join(WATCHING)}`: only of kinds {watching}. `{'`, `'.join(SCOPED)}`: not of kind always.\n"
    yield from _table([*COMMON, *SCOPED, *WATCHING], ("name", "kind"))


def _kind(name: str, kind: Kind) -> Iterator[str]:
    yield f"## {name}\n"
    yield f"{kind.title}\n"
    if kind.scopes:
        default = "pair" if name == "proximity" else "agent"
        yield f"Scopes: {', '.join(f'`{scope}`' for scope in kind.scopes)}; `{default}` when nothing is said.\n"
    if kind.choices:
        groups = " or ".join(" and ".join(f"`{key}`" for key in keys) for keys in kind.choices)
        yield f"Needs {groups}.\n"
    if kind.own:
        yield from _table(kind.own, kind.required)


def _table(keys: Sequence[str], required: Sequence[str]) -> Iterator[str]:
    yield "| key | | value | default | meaning |"
    yield "| --- | --- | --- | --- | --- |"
    for key in keys:
        described = PROPERTIES[key]
        needed = "required" if key in required else ""
        default = f"`{described['default']}`".lower() if described.get("default", "") != "" else ""
        cells = (f"`{key}`", needed, _value(described), default, described.get("description", ""))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells).replace("  ", " ") + " |"
    yield ""


def _value(schema: Mapping[str, Any]) -> str:
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    if schema.get("type") in ("number", "integer"):
        return f"{schema['type']} from {schema['minimum']:g} to {schema['maximum']:g}"
    if schema.get("type") == "array":
        return f"list of {schema.get('minItems', 0)} to {schema.get('maxItems', 'many')}"
    return {"string": "text", "object": "mapping", "boolean": "`true`, `false`"}[schema["type"]]
