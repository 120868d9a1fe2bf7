"""The view on a terminal: a line about the whole, the fleet, the way of each task, and rates.

It shows how things are; what happened goes by above it, line by line.
"""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import islice

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from robotkube.cli.live import fleet
from robotkube.cli.live.feed import PlatformPicture
from robotkube.cli.live.fleet import AgentRow
from robotkube.cli.live.ways import TaskWay, way
from robotkube.cli.terminal.printing import printable

TASKS_MAX = 5
RATES_MAX = 4
LINES_BESIDE_FLEET = 14  # the lines of all else, and some of what happened above
AGENTS_MIN = 3
SECOND = 1_000_000_000


def view(picture: PlatformPicture, now_ns: int, lines: int) -> RenderableType:
    """The picture as it is drawn on a terminal of so many lines; `now_ns`: since 1970."""
    if not picture.is_read:
        return Text("the platform is being read", style="dim")
    agents = fleet.rows(picture.nodes.values(), picture.pods.values())
    parts: list[RenderableType] = [_heading(picture, agents, now_ns)]
    if words := fleet.trial(picture.nodes.values()):
        parts.append(Text(printable(words), style="yellow", overflow="fold"))
    if picture.problem:
        parts.append(Text(printable(f"what is shown may be old: {picture.problem}"), style="bold red", overflow="fold"))
    shown = agents[: max(AGENTS_MIN, lines - LINES_BESIDE_FLEET)]
    parts.append(_fleet(shown))
    if len(shown) < len(agents):
        rest = agents[len(shown) :]
        parts.append(Text(f"and {len(rest)} more, {sum(one.is_fine for one in rest)} of them ready", style="dim"))
    ways = [way(key, task, picture.plans.values()) for key, task in picture.tasks.items()]
    standing = sorted((one for one in ways if one), key=lambda one: -one.begin)
    parts += [_way(one, now_ns) for one in standing[:TASKS_MAX]]
    if picture.rates:
        parts.append(_rates(picture.rates))
    return Group(*parts)


def _heading(picture: PlatformPicture, agents: list[AgentRow], now_ns: int) -> Text:
    fine = sum(agent.is_fine for agent in agents)
    under_way = sum(plan["observed"] is None and plan["error"] is None for plan in picture.plans.values())
    counted = [f"{fine} of {len(agents)} agents ready", _count(len(picture.tasks), "task")]
    counted += [f"{_count(under_way, 'plan')} under way"] if under_way else []
    return Text.assemble((clock(now_ns), "bold"), f"  {', '.join(counted)}")


def _fleet(agents: list[AgentRow]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for heading in ("AGENT", "ROLE", "NODE", "PODS"):
        table.add_column(heading, no_wrap=True)
    table.add_column("RUNS", no_wrap=True, overflow="ellipsis", ratio=1)
    for agent in agents:
        node = Text(_node(agent), style="" if agent.ready else "bold red")
        ready = "?" if agent.silent else agent.pods_ready  # what a silent Node's pods do, nobody knows
        pods = Text(f"{ready}/{agent.pods}", style="" if agent.pods_ready == agent.pods else "yellow")
        table.add_row(Text(agent.agent), Text(agent.role), node, pods, Text(", ".join(agent.runs)))
    return table


def _node(agent: AgentRow) -> str:
    if agent.ready:
        return "ready"
    since = f" since {clock(agent.since)}" if agent.since else ""
    return f"{'silent' if agent.silent else 'not ready'}{since}"


def _way(one: TaskWay, now_ns: int) -> Text:
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(one.task, style="bold")
    text.append(f"  event {clock(one.begin)}")
    for stage, time in one.stages:
        text.append(f"  {stage} +{(time - one.begin) / SECOND:.1f} s", style="green")
    if one.problem:
        text.append(printable(f"  {one.problem}"), style="bold red")
    elif one.awaits:
        text.append(f"  {one.awaits} … {max(0, now_ns - one.begin) / SECOND:.0f} s", style="yellow")
    return text


def _rates(rates: dict[str, float]) -> Text:
    most = islice(sorted(rates.items(), key=lambda pair: -pair[1]), RATES_MAX)
    words = ", ".join(f"{topic} {rate:.0f}/s" for topic, rate in most)
    return Text(printable(f"detectors receive {words}"), style="dim", no_wrap=True, overflow="ellipsis")


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def clock(nanoseconds: int) -> str:
    """The time of day, UTC."""
    return f"{datetime.fromtimestamp(nanoseconds / SECOND, UTC):%H:%M:%S}"
