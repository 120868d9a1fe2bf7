"""`make reference`: docs/reference/schemas.md from the JSON Schemas of registry/schemas/, metrics.md, rules.md, logs.md
and the metrics of event-detector.md from the code, the commands of command-line.md from the command line's parser, and
the tables of network.md and monitoring.md from the platform chart's; the message types of images; the table of attacks
in trust.md; and what is generated in charts.
"""

from __future__ import annotations

from ci.folders import PROJECT
from ci.reference import (
    architecture,
    attacks,
    charts,
    commands,
    detector,
    logs,
    message_types,
    metrics,
    monitoring,
    network,
    rules,
    schemas,
)
from ci.reference.walks import page as walks


def main() -> None:
    """Write every page, and print which."""
    schemas.PAGE.write_text(schemas.page(schemas.read_schemas()), encoding="utf-8")
    metrics.PAGE.write_text(metrics.page(), encoding="utf-8")
    commands.PAGE.write_text(commands.page(commands.PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    rules.PAGE.write_text(rules.page(), encoding="utf-8")
    logs.PAGE.write_text(logs.page(logs.events()), encoding="utf-8")
    print(logs.PAGE.relative_to(PROJECT))
    detector.PAGE.write_text(detector.page(detector.PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(detector.PAGE.relative_to(PROJECT))
    print(rules.PAGE.relative_to(PROJECT), *(path.relative_to(PROJECT) for path in charts.write()))
    print(*(path.relative_to(PROJECT) for path in (schemas.PAGE, metrics.PAGE, commands.PAGE)))
    print(network.write().relative_to(PROJECT), monitoring.write().relative_to(PROJECT))
    print(*(path.relative_to(PROJECT) for path in message_types.write()))
    architecture.write()
    attacks.write()
    walks.write()


if __name__ == "__main__":
    main()
