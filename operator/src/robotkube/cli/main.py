"""The command `robotkube <noun> <verb>`: what runs, what was asked for, what was planned and recorded.

stdout is data (`--output table|yaml|json`), stderr is talk. Ends with 0 done, 1 refused, 2 wrong usage, 3 something is
unreachable (API server, manager, forge, database) or did not come in time, 4 nothing speaks against it and
nothing proves it. Access: a kubeconfig (`--kubeconfig`, KUBECONFIG); forge and manager are reached through the API
server.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from robotkube.cli.output import FORMATS, Table, write
from robotkube.cli.terminal import screen
from robotkube.cli.terminal.bars import working
from robotkube.cli.terminal.printing import printable
from robotkube.errors import InputError, RefusalError, RobotKubeError, UnavailableError

EXIT_DONE = 0
EXIT_REFUSED = 1
EXIT_USAGE = 2
EXIT_UNREACHABLE = 3
EXIT_UNPROVED = 4


@dataclass(frozen=True)
class Command:
    """One verb of a noun; without a verb the noun is the command. `function` of `module` (below `robotkube.cli`) runs
    it, `adder` adds its arguments; the module is imported when it is needed, since all of them take two seconds.
    `takes_long`: on a terminal a line says that it is at work; it asks nobody for anything meanwhile."""

    noun: str
    verb: str
    summary: str
    module: str
    function: str
    adder: str = ""
    takes_long: bool = False

    @property
    def words(self) -> list[str]:
        """What a person writes to name it."""
        return [self.noun, self.verb] if self.verb else [self.noun]

    def run(self, options: argparse.Namespace) -> Table | None:
        """Run it."""
        with self._shown_at_work():
            table: Table | None = getattr(self._imported(), self.function)(options)
        return table

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add its own arguments."""
        if self.adder:
            getattr(self._imported(), self.adder)(parser)

    def _shown_at_work(self) -> AbstractContextManager[None]:
        if not self.takes_long:
            return nullcontext()
        return screen.showing(working(" ".join(["robotkube", *self.words]), time.monotonic()))

    def _imported(self) -> ModuleType:
        return import_module(f"robotkube.cli.{self.module}")


COMMANDS = (
    Command(
        "task",
        "submit",
        "ask for an application, or change what was asked",
        "tasks.submit",
        "submit_task",
        "submitting",
    ),
    Command("task", "list", "tasks of all agents", "tasks.listing", "list_tasks", "listing"),
    Command("task", "show", "everything about one task", "tasks.listing", "show_task", "naming"),
    Command(
        "task",
        "explain",
        "a decision in words, also about a task that is not submitted",
        "tasks.explain",
        "explain_task",
        "explaining",
    ),
    Command("task", "watch", "conditions of tasks as they change", "tasks.watch", "watch_tasks", "watching"),
    Command("task", "withdraw", "delete a task: its demand ends", "tasks.listing", "withdraw_task", "withdrawing"),
    Command("release", "list", "releases, the demands on them, and what the cluster shows", "plans", "list_releases"),
    Command(
        "agent",
        "list",
        "agents, whether their accounts at the broker are open, and what their Nodes say",
        "agents.accounts",
        "list_agents",
        "reading",
    ),
    Command(
        "agent",
        "enroll",
        "propose that a reserved agent be enrolled; once it is, write the file with which its machine joins",
        "agents.enrolling",
        "enroll_agent",
        "enrolling",
    ),
    Command(
        "agent",
        "withdraw",
        "propose that an enrolled agent leave the fleet: its releases go, its account is shut",
        "agents.enrolling",
        "withdraw_agent",
        "withdrawing",
    ),
    Command(
        "agent",
        "revoke",
        "propose that an agent's connections at the broker end, and none begins",
        "agents.revoking",
        "revoke_agent",
        "revoking",
    ),
    Command(
        "agent",
        "restore",
        "propose that a revoked agent may be at the broker again",
        "agents.revoking",
        "restore_agent",
        "restoring",
    ),
    Command(
        "agent",
        "rights",
        "what an agent may say and hear at the broker, and which commit gave each",
        "agents.rights",
        "show_rights",
        "asking",
    ),
    Command(
        "watch",
        "",
        "what the platform does, as it does it; on a terminal with a view of the fleet",
        "live.watch",
        "watch_platform",
        "watching",
    ),
    Command(
        "open",
        "",
        "open the address of the fleet, of why something is so, of a plan or of a recording",
        "cluster.opening",
        "open_page",
        "naming",
    ),
    Command("trace", "", "from an event to the pods and recordings it led to", "traces", "trace", "tracing"),
    Command(
        "audit",
        "",
        "what ran, for whom and on what evidence, from Git and registry alone, and what was manipulated",
        "audit",
        "audit",
        "auditing",
        takes_long=True,
    ),
    Command(
        "status",
        "",
        "main of the deployment repository, what stands there unchecked, a gate that is away, strangers that run",
        "status",
        "show_status",
        "asking",
        takes_long=True,
    ),
    Command(
        "preflight",
        "",
        "whether a cluster can take the platform's chart, or go on with it; without --probe nothing is changed",
        "cluster.preflight",
        "check_cluster",
        "asking",
        takes_long=True,
    ),
    Command(
        "wait",
        "",
        "a line for each component of an installation when it is ready, and what hangs, until all are",
        "live.waiting",
        "wait_for_installation",
        "waiting",
    ),
    Command(
        "break-glass",
        "sign",
        "sign a change that goes to main without the gate, as the first or the next person",
        "break_glass",
        "sign_change",
        "signing",
    ),
    Command(
        "break-glass",
        "push",
        "push a change that two people have signed to main",
        "break_glass",
        "push_change",
        "pushing",
    ),
    Command("plan", "list", "plans of the manager with their times", "plans", "list_plans"),
    Command("recording", "list", "what was recorded", "recordings.commands", "list_all", "listing"),
    Command("recording", "show", "everything about one recording", "recordings.commands", "show", "naming"),
    Command(
        "recording",
        "verify",
        "prove checksums and gaps of a recording, and compare it with ledgers",
        "recordings.commands",
        "verify_one",
        "verifying",
        takes_long=True,
    ),
    Command(
        "recording",
        "export",
        "a recording as a bag, and as a labelled dataset",
        "recordings.export",
        "export",
        "exporting",
        takes_long=True,
    ),
    Command("rule", "test", "the events that rules raise over bags", "rules", "test", "testing", takes_long=True),
    Command("rule", "explain", "the messages and values that an event came from", "rules", "explain", "explaining"),
    Command("registry", "list", "every application and chart", "registry.commands", "list_entries", "choosing_sources"),
    Command("registry", "search", "applications and charts", "registry.commands", "search_entries", "searching"),
    Command("registry", "show", "everything about one entry", "registry.commands", "show_entry", "naming"),
    Command("registry", "graph", "versions and their upgrades", "registry.commands", "show_graph", "drawing"),
    Command(
        "registry",
        "validate",
        "every mistake in the catalogue's sources",
        "registry.commands",
        "validate_registry",
        "validating",
        takes_long=True,
    ),
    Command("registry", "new", "start an application: charts and their entries", "registry.new", "new", "naming"),
    Command(
        "registry",
        "try",
        "run the suites that can be run here, before anything is submitted",
        "registry.trying",
        "try_suites",
        "choosing",
        takes_long=True,
    ),
    Command(
        "registry",
        "submit",
        "have charts and applications verified and published",
        "registry.submit",
        "submit",
        "submitting",
        takes_long=True,
    ),
    Command(
        "registry",
        "admission",
        "what may run, as a ConfigMap; or what would not start again (--stranded)",
        "registry.admission_list",
        "show_list",
        "listing_arguments",
    ),
    Command(
        "image",
        "build",
        "build a folder's Dockerfile, the same each time, with its bill of materials",
        "images.building",
        "build",
        "choosing",
    ),
    Command(
        "image",
        "push",
        "push an image with its bill to its publisher's place, and write its reference where charts are packed",
        "images.pushing",
        "push",
        "choosing",
    ),
    Command(
        "bundle", "show", "what a bundle holds: the platform in one file", "bundles.reading", "show_bundle", "showing"
    ),
    Command(
        "bundle",
        "push",
        "copy a bundle to an OCI registry, every digest as it is",
        "bundles.pushing",
        "push_bundle",
        "pushing",
    ),
    Command(
        "bundle",
        "load",
        "bring a bundle's images to a kind cluster, k3s or containerd, without a registry",
        "bundles.loading",
        "load_bundle",
        "loading",
    ),
    Command(
        "bundle",
        "manifests",
        "Argo CD's objects of a bundle, to apply",
        "bundles.reading",
        "show_manifests",
        "printing",
    ),
    Command("version", "", "versions of this program and of the platform", "versions", "show_versions", "asking"),
    Command("completion", "", "completion of commands in a shell", "completion", "complete", "naming"),
)
"""Every command; other modules of the command line add theirs here."""


def add_access_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command, from which `Platform` is made."""
    parser.add_argument("--kubeconfig", help="file with access to the cluster (default: KUBECONFIG)")
    parser.add_argument("--context", help="context of the kubeconfig")
    parser.add_argument("--platform-namespace", default="robotkube", help="where the platform is installed")
    parser.add_argument("--argocd-namespace", default="argocd", help="where Argo CD is installed")
    parser.add_argument("--manager", default="manager", help="which manager, where there are several")


def parser(commands: Sequence[Command] = COMMANDS) -> argparse.ArgumentParser:
    """The command line's grammar, of these commands."""
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
        add_access_arguments(verb)
        verb.add_argument("-o", "--output", choices=FORMATS, default="table", help="form of the data on stdout")
        command.add_arguments(verb)
        verb.set_defaults(command=command, grammar=root)
    return root


def grammar_of(words: Sequence[str]) -> argparse.ArgumentParser:
    """The grammar as far as these words need it: their command's, else, and for completion, that of all commands."""
    named = [command for command in COMMANDS if list(words[: len(command.words)]) == command.words]
    return parser(named if named and named[0].noun != "completion" else COMMANDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, and return the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    options = grammar_of(words).parse_args(words)
    try:
        table = options.command.run(options)
    except RobotKubeError as error:
        print(printable(f"robotkube: {error}"), file=sys.stderr)
        return exit_code(error)
    except KeyboardInterrupt:
        print("robotkube: interrupted", file=sys.stderr)
        return EXIT_REFUSED
    if table is not None:
        write(table, options.output, sys.stdout)
        if table.is_empty:
            print(f"robotkube: no {table.name.replace('_', ' ')} found", file=sys.stderr)
        problems = (
            (table.refusal, EXIT_REFUSED),
            (table.unreachable, EXIT_UNREACHABLE),
            (table.reservation, EXIT_UNPROVED),
        )
        codes = [code for problem, code in problems if problem]
        for problem, _ in problems:
            if problem:
                print(printable(f"robotkube: {problem}"), file=sys.stderr)
        return codes[0] if codes else EXIT_DONE
    return EXIT_DONE


def exit_code(error: RobotKubeError) -> int:
    """The exit code of an error."""
    codes = ((RefusalError, EXIT_REFUSED), (UnavailableError, EXIT_UNREACHABLE), (InputError, EXIT_USAGE))
    return next((code for kind, code in codes if isinstance(error, kind)), EXIT_REFUSED)
