"""Charts whose interfaces are wrong, one mistake each: what `registry new` writes, with that mistake made in it.

    charts = wrong_chart("undeclared-topic", folder)      # folder/charts/undeclared-topic, folder/registry/...

Each passes `registry validate` and the static suite, and fails the interface suite.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robotkube.registry.catalogue.adapters.skeletons import FIRST_VERSION, new_application
from tests.stages.paths import CHARTS

LIBRARY = CHARTS / "apps" / "robotkube-app"
NODE, ENTRY = "charts/{name}/files/node.py", "registry/charts/{name}/0.1.0.yaml"


@dataclass(frozen=True)
class Mistake:
    """A mistake in an interface. `changes`: file -> (text, text instead), each text stands there once. `check`, `found`
    and `fix` are words of the failed check that says it, after the set's name when `per_set`; `alone`: no other check
    fails."""

    changes: Mapping[str, Sequence[tuple[str, str]]]
    check: str
    found: str
    fix: str
    per_set: bool = True
    alone: bool = True


MISTAKES: Mapping[str, Mistake] = {
    "undeclared-topic": Mistake(
        {NODE: [("    ready.set()\n", '    node.create_publisher(String, "/hidden/count", QOS)\n    ready.set()\n')]},
        "undeclared topic ros out /hidden/count",
        "node /undeclared_topic publishes /hidden/count (std_msgs/msg/String), which no interface declares",
        "declare it as an interface in the entry",
    ),
    "wrong-type": Mistake(
        {ENTRY: [("type: std_msgs/msg/String\n    qos: {reliability: reliable, durability: volatile}\n  suites:",
                  "type: std_msgs/msg/Int32\n    qos: {reliability: reliable, durability: volatile}\n  suites:")]},
        "ros out /first/out: wrong type",
        "it publishes to it as std_msgs/msg/String, declared is std_msgs/msg/Int32",
        "declare type std_msgs/msg/String in interface output",
    ),
    "wrong-quality": Mistake(
        {NODE: [("ReliabilityPolicy.RELIABLE", "ReliabilityPolicy.BEST_EFFORT")]},
        "ros out /first/out: wrong reliability",
        "its publisher is best_effort, declared is reliable",
        "declare qos.reliability: best_effort in interface output",
        alone=False,
    ),
    "unused-input": Mistake(
        {NODE: [('settings["input"], answering(publisher), QOS', 'settings["input"], lambda message: None, QOS')]},
        "ros in /first/in leads to an output",
        "after messages (std_msgs/msg/String) were sent to /first/in nothing was seen",
        "use the input, or correct `causes` of interface input",
    ),
    "fixed-topic": Mistake(
        {NODE: [('settings["output"], QOS', '"/second/out", QOS')]},
        "ros out /first/out: declared but absent",
        "no node of the chart had a publisher of /first/out",
        "open it, or correct interface output in the entry",
        alone=False,
    ),
    "same-topics": Mistake(
        {ENTRY: [("relay: {input: /second/in, output: /second/out}", "relay: {input: /first/in, output: /first/out}")]},
        "the test sets give different topics",
        "first and second both give ros in /first/in, ros out /first/out",
        "give every set values that lead to other topics",
        per_set=False,
    ),
    "unstated-output": Mistake(
        {ENTRY: [("    causes: output\n", "")]},
        "interface input states its output",
        "nothing says which output its input leads to",
        "write causes: one of output",
        per_set=False,
    ),
}  # fmt: skip


def wrong_chart(name: str, folder: Path) -> tuple[Path, Path]:
    """Write the chart and its entry below `folder` (charts/, registry/); their paths."""
    return write_chart(name, MISTAKES[name].changes, folder)


def write_chart(name: str, changed: Mapping[str, Sequence[tuple[str, str]]], folder: Path) -> tuple[Path, Path]:
    """What `registry new` writes, with changes made in it (file -> text, text instead); paths of chart and entry."""
    charts, registry = folder / "charts", folder / "registry"
    for place in (charts, registry / "applications", registry / "charts"):
        place.mkdir(parents=True, exist_ok=True)
    if not (charts / LIBRARY.name).exists():
        (charts / LIBRARY.name).symlink_to(LIBRARY, target_is_directory=True)
    new_application(name, f"wrong/{name}", charts, registry)
    for file, changes in changed.items():
        path = folder / file.format(name=name)
        text = path.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, f"{path}: {old!r} does not stand there once"
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
    return charts / name, registry / "charts" / name / f"{FIRST_VERSION}.yaml"
