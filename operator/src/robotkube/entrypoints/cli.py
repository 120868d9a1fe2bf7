"""`robotkube <noun> <verb>`: what runs, what was asked for, what was planned and recorded.

stdout is data (`--output table|yaml|json`), stderr is talk. Ends with 0 done, 1 refused, 2 wrong usage, 3 the world is
unreachable. Access: a kubeconfig (`--kubeconfig`, KUBECONFIG); forge and manager are reached through the API server.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robotkube.domain.errors import InputError, RefusalError, RobotKubeError, UnavailableError
from robotkube.entrypoints.cli_output import FORMATS, Table, write
from robotkube.entrypoints.cli_platform import Platform

EXIT_DONE, EXIT_REFUSED, EXIT_USAGE, EXIT_UNREACHABLE = 0, 1, 2, 3


@dataclass(frozen=True)
class Command:
    """One verb of a noun; without a verb the noun is the command."""

    noun: str
    verb: str
    summary: str
    run: Callable[[argparse.Namespace], Table | None]
    arguments: Callable[[argparse.ArgumentParser], None] = lambda parser: None


def commands() -> Sequence[Command]:
    """Every command; other modules of the command line add theirs here."""
    from robotkube.entrypoints import (
        cli_explaining,
        cli_exporting,
        cli_plans,
        cli_recordings,
        cli_registry,
        cli_registry_new,
        cli_registry_submit,
        cli_rules,
        cli_submit,
        cli_tasks,
        cli_tracing,
        cli_watching,
    )

    return [
        Command(
            "task",
            "submit",
            "ask for an application, or change what was asked",
            cli_submit.submit_task,
            cli_submit.submitting,
        ),
        Command("task", "list", "tasks of all agents", cli_tasks.list_tasks, cli_tasks.listing),
        Command("task", "show", "everything about one task", cli_tasks.show_task, cli_tasks.naming),
        Command(
            "task",
            "explain",
            "a decision in words, also about a task that is not submitted",
            cli_explaining.explain_task,
            cli_explaining.explaining,
        ),
        Command("task", "watch", "conditions of tasks as they change", cli_watching.watch_tasks, cli_watching.watching),
        Command("task", "withdraw", "delete a task: its demand ends", cli_tasks.withdraw_task, cli_tasks.withdrawing),
        Command(
            "release", "list", "releases, the demands on them, and what the cluster shows", cli_plans.list_releases
        ),
        Command(
            "trace", "", "from an event to the pods and recordings it led to", cli_tracing.trace, cli_tracing.tracing
        ),
        Command("plan", "list", "plans of the manager with their times", cli_plans.list_plans),
        Command("recording", "list", "what was recorded", cli_recordings.list_all, cli_recordings.listing),
        Command("recording", "show", "everything about one recording", cli_recordings.show, cli_recordings.naming),
        Command(
            "recording",
            "verify",
            "prove checksums and gaps of a recording, and compare it with ledgers",
            cli_recordings.verify_one,
            cli_recordings.verifying,
        ),
        Command(
            "recording",
            "export",
            "a recording as a bag, and as a labelled dataset",
            cli_exporting.export,
            cli_exporting.exporting,
        ),
        Command("rule", "test", "the events that rules raise over bags", cli_rules.test, cli_rules.testing),
        Command(
            "rule",
            "explain",
            "the messages and values that an event came from",
            cli_rules.explain,
            cli_rules.explaining,
        ),
        Command("registry", "search", "applications and charts", cli_registry.search_entries, cli_registry.searching),
        Command("registry", "show", "everything about one entry", cli_registry.show_entry, cli_registry.naming),
        Command("registry", "graph", "versions and their upgrades", cli_registry.show_graph, cli_registry.drawing),
        Command(
            "registry",
            "validate",
            "every mistake in the catalogue's sources",
            cli_registry.validate_registry,
            cli_registry.validating,
        ),
        Command(
            "registry",
            "new",
            "start an application: a chart and its entries",
            cli_registry_new.new,
            cli_registry_new.naming,
        ),
        Command(
            "registry",
            "submit",
            "have charts and applications verified and published",
            cli_registry_submit.submit,
            cli_registry_submit.submitting,
        ),
    ]


def parser(found: Sequence[Command]) -> argparse.ArgumentParser:
    """The command line's grammar."""
    root = argparse.ArgumentParser(prog="robotkube", description="Look into and steer a RobotKube platform.")
    nouns = root.add_subparsers(dest="noun", required=True, metavar="<noun>")
    parsers: dict[str, argparse._SubParsersAction[argparse.ArgumentParser]] = {}
    for command in found:
        if not command.verb:
            verb = nouns.add_parser(command.noun, help=command.summary, description=command.summary)
        else:
            if command.noun not in parsers:
                noun = nouns.add_parser(command.noun, help=", ".join(c.verb for c in found if c.noun == command.noun))
                parsers[command.noun] = noun.add_subparsers(dest="verb", required=True, metavar="<verb>")
            verb = parsers[command.noun].add_parser(command.verb, help=command.summary, description=command.summary)
        Platform.add_arguments(verb)
        verb.add_argument("-o", "--output", choices=FORMATS, default="table", help="form of the data on stdout")
        command.arguments(verb)
        verb.set_defaults(command=command)
    return root


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    options = parser(commands()).parse_args(arguments)
    try:
        table = options.command.run(options)
    except RobotKubeError as error:
        print(f"robotkube: {error}", file=sys.stderr)
        return exit_code(error)
    except KeyboardInterrupt:
        return EXIT_REFUSED
    if table is not None:
        write(table, options.output, sys.stdout)
        if table.refusal:
            print(f"robotkube: {table.refusal}", file=sys.stderr)
            return EXIT_REFUSED
    return EXIT_DONE


def exit_code(error: RobotKubeError) -> int:
    """The exit code of an error."""
    codes = ((RefusalError, EXIT_REFUSED), (UnavailableError, EXIT_UNREACHABLE), (InputError, EXIT_USAGE))
    return next((code for kind, code in codes if isinstance(error, kind)), EXIT_REFUSED)


if __name__ == "__main__":
    sys.exit(main())
