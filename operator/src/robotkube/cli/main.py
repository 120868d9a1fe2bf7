"""The command `robotkube <noun> <verb>`: what runs, what was asked for, what was planned and recorded.

stdout is data (`--output table|yaml|json`), stderr is talk. Ends with 0 done, 1 refused, 2 wrong usage, 3 something is
unreachable (API server, manager, forge, database) or did not come in time, 4 nothing speaks against it and
nothing proves it. Access: a kubeconfig (`--kubeconfig`, KUBECONFIG); forge and manager are reached through the API
server.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robotkube.cli.output import FORMATS, Table, write
from robotkube.cli.platform import Platform
from robotkube.errors import InputError, RefusalError, RobotKubeError, UnavailableError

EXIT_DONE = 0
EXIT_REFUSED = 1
EXIT_USAGE = 2
EXIT_UNREACHABLE = 3
EXIT_UNPROVED = 4


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
    from robotkube.cli import audit, break_glass, completion, plans, status, traces, versions
    from robotkube.cli import rules as cli_rules
    from robotkube.cli.recordings import commands as cli_recordings
    from robotkube.cli.recordings import export
    from robotkube.cli.registry import admission_list, new
    from robotkube.cli.registry import commands as cli_registry
    from robotkube.cli.registry import submit as cli_registry_submit
    from robotkube.cli.tasks import explain, listing, watch
    from robotkube.cli.tasks import submit as cli_submit

    return [
        Command(
            "task",
            "submit",
            "ask for an application, or change what was asked",
            cli_submit.submit_task,
            cli_submit.submitting,
        ),
        Command("task", "list", "tasks of all agents", listing.list_tasks, listing.listing),
        Command("task", "show", "everything about one task", listing.show_task, listing.naming),
        Command(
            "task",
            "explain",
            "a decision in words, also about a task that is not submitted",
            explain.explain_task,
            explain.explaining,
        ),
        Command("task", "watch", "conditions of tasks as they change", watch.watch_tasks, watch.watching),
        Command("task", "withdraw", "delete a task: its demand ends", listing.withdraw_task, listing.withdrawing),
        Command("release", "list", "releases, the demands on them, and what the cluster shows", plans.list_releases),
        Command("trace", "", "from an event to the pods and recordings it led to", traces.trace, traces.tracing),
        Command(
            "audit",
            "",
            "what ran, for whom and on what evidence, from Git and registry alone, and what was manipulated",
            audit.audit,
            audit.auditing,
        ),
        Command(
            "status",
            "",
            "main of the deployment repository, what stands there unchecked, a gate that is away, strangers that run",
            status.show_status,
            status.asking,
        ),
        Command(
            "break-glass",
            "sign",
            "sign a change that goes to main without the gate, as the first or the next person",
            break_glass.sign_change,
            break_glass.signing,
        ),
        Command(
            "break-glass",
            "push",
            "push a change that two people have signed to main",
            break_glass.push_change,
            break_glass.pushing,
        ),
        Command("plan", "list", "plans of the manager with their times", plans.list_plans),
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
            export.export,
            export.exporting,
        ),
        Command("rule", "test", "the events that rules raise over bags", cli_rules.test, cli_rules.testing),
        Command(
            "rule",
            "explain",
            "the messages and values that an event came from",
            cli_rules.explain,
            cli_rules.explaining,
        ),
        Command(
            "registry", "list", "every application and chart", cli_registry.list_entries, cli_registry.choosing_sources
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
            new.new,
            new.naming,
        ),
        Command(
            "registry",
            "submit",
            "have charts and applications verified and published",
            cli_registry_submit.submit,
            cli_registry_submit.submitting,
        ),
        Command(
            "registry",
            "admission",
            "what may run, as a ConfigMap; or what would not start again (--stranded)",
            admission_list.show_list,
            admission_list.listing_arguments,
        ),
        Command("version", "", "versions of this program and of the platform", versions.show_versions, versions.asking),
        Command("completion", "", "completion of commands in a shell", completion.complete, completion.naming),
    ]


def parser(commands: Sequence[Command]) -> argparse.ArgumentParser:
    """The command line's grammar."""
    root = argparse.ArgumentParser(prog="robotkube", description="Look into and steer a RobotKube platform.")
    nouns = root.add_subparsers(dest="noun", required=True, metavar="<noun>")
    parsers: dict[str, argparse._SubParsersAction[argparse.ArgumentParser]] = {}
    for command in commands:
        if not command.verb:
            verb = nouns.add_parser(command.noun, help=command.summary, description=command.summary)
        else:
            if command.noun not in parsers:
                noun = nouns.add_parser(
                    command.noun, help=", ".join(c.verb for c in commands if c.noun == command.noun)
                )
                parsers[command.noun] = noun.add_subparsers(dest="verb", required=True, metavar="<verb>")
            verb = parsers[command.noun].add_parser(command.verb, help=command.summary, description=command.summary)
        Platform.add_arguments(verb)
        verb.add_argument("-o", "--output", choices=FORMATS, default="table", help="form of the data on stdout")
        command.arguments(verb)
        verb.set_defaults(command=command, grammar=root)
    return root


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, and return the exit code."""
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
        problems = (
            (table.refusal, EXIT_REFUSED),
            (table.unreachable, EXIT_UNREACHABLE),
            (table.reservation, EXIT_UNPROVED),
        )
        codes = [code for problem, code in problems if problem]
        for problem, _ in problems:
            if problem:
                print(f"robotkube: {problem}", file=sys.stderr)
        return codes[0] if codes else EXIT_DONE
    return EXIT_DONE


def exit_code(error: RobotKubeError) -> int:
    """The exit code of an error."""
    codes = ((RefusalError, EXIT_REFUSED), (UnavailableError, EXIT_UNREACHABLE), (InputError, EXIT_USAGE))
    return next((code for kind, code in codes if isinstance(error, kind)), EXIT_REFUSED)
