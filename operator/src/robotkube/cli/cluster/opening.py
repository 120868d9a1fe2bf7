"""The command `robotkube open`: the address at which the fleet, the reasons of something, a plan or a recording is
seen, opened in a browser.

That is the console; where there is none, or who opens it wants that, the forge's page of a plan, and for the rest the
command that shows it.
"""

from __future__ import annotations

import argparse
import socket
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote, urlsplit

import urllib3

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.documents.core.patterns import COMMIT_START
from robotkube.foundation.kubernetes.core.objects import object_key

CONSOLE = "console"
DEPLOYMENT = "robotkube/deployment"
FLEET, WHY, PLAN, RECORDING = "fleet", "why", "plan", "recording"
KINDS = ("event", "task", "plan", "pod", "release", "commit")
TLS_PORTS = (443, 8443)
HERE = "localhost"
ANSWERS_SECONDS_MAX = 2.0
FORGE_SECONDS_MAX = 3.0
PAGES_MADE = "/assets/licenses.txt"  # there with all that the forge's pages load, and served without signing in
VIEWER = "viewer"  # the account of the embedded cluster that sees pull requests and nothing else

Document = Mapping[str, Any]


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "what", nargs="?", choices=(FLEET, WHY, PLAN, RECORDING), default=FLEET, help="what to see (default: fleet)"
    )
    parser.add_argument(
        "id",
        nargs="?",
        default="",
        metavar="ID",
        help="with why: of an event, a trace, a task, a plan, a pod, a release or a commit; with plan: its id or the "
        "number of its pull request; with recording: its name",
    )
    parser.add_argument("--print", action="store_true", help="only print the address")
    parser.add_argument(
        "--console-url", metavar="URL", help="the console (default: where people sign in, or its Service)"
    )
    parser.add_argument(
        "--forge", action="store_true", help="with plan: its pull request at the forge, also where there is a console"
    )


def open_page(options: argparse.Namespace) -> Table:
    """Print the address of what is named, and open it. RefusalError names the command to use instead, where nothing
    has an address."""
    if options.what == FLEET and options.id:
        raise InputError(f"open fleet {options.id}: the fleet has no ID; leave it out, or write open why {options.id}")
    if options.what != FLEET and not options.id:
        raise InputError(f"open {options.what}: name which one, such as `robotkube open {EXAMPLES[options.what]}`")
    if options.forge and options.what != PLAN:
        raise InputError(f"open {options.what} --forge: the forge has pages of plans alone; write open plan ID --forge")
    platform = Platform(options)
    console = options.console_url or console_address(platform)
    if options.forge:
        address = _at_forge(platform, named_plan(options.id, platform.page("/plans")["plans"]))
    elif console:
        address = console.rstrip("/") + _path(platform, options.what, options.id)
    else:
        address = _without_console(platform, options)
    if address.startswith(f"http://{HERE}:") and not answers(address):
        print(f"robotkube: nothing answers there: {_forward(platform, options)}, and keep it running", file=sys.stderr)
    elif not options.print and not webbrowser.open(address):
        print("robotkube: no browser could be opened here; open the address yourself", file=sys.stderr)
    return Table("page", (), [{"what": options.what, "address": address}], single=True, text=f"{address}\n")


EXAMPLES = {WHY: "why cloud-0/meeting", PLAN: "plan 4", RECORDING: "recording NAME"}


def console_address(platform: Platform) -> str:
    """The console's address for people: its own address where they sign in, this machine's end of a forward where it
    answers nothing else, otherwise its Service; empty when there is none."""
    try:
        host, port = platform.address(CONSOLE)
    except InputError:
        return ""
    settings = platform.settings(CONSOLE)
    if settings.get("sign_in"):
        return str(settings["sign_in"]["url"])
    if settings.get("by_forward"):
        return f"http://{HERE}:{port}"
    return f"{'https' if port in TLS_PORTS else 'http'}://{host}:{port}"


def answers(address: str) -> bool:
    """Return whether somebody listens at the host and port of an address."""
    parts = urlsplit(address)
    try:
        socket.create_connection((parts.hostname or HERE, parts.port or 80), ANSWERS_SECONDS_MAX).close()
    except OSError:
        return False
    return True


def _forward(platform: Platform, options: argparse.Namespace) -> str:
    """The command of which this machine's end answers in the console's place."""
    _, port = platform.address(CONSOLE)
    cluster = [("--kubeconfig", options.kubeconfig), ("--context", options.context)]
    words = "".join(f" {key} {value}" for key, value in cluster if value)
    return f"run `kubectl{words} -n {options.platform_namespace} port-forward service/{CONSOLE} {port}`"


def _path(platform: Platform, what: str, wanted: str) -> str:
    """The console's path of what is named."""
    if what == FLEET:
        return "/"
    if what == RECORDING:
        return f"/#/recordings/{quote(wanted, safe='')}"
    plans = platform.page("/plans")["plans"]
    if what == PLAN:
        kind = PLAN
        name = str(named_plan(wanted, plans)["plan"])
    else:
        kind = kind_of(wanted, platform.tasks(), plans, platform.pods())
        name = wanted
    return f"/#/{WHY}/{kind}/{quote(name)}"


def named_plan(wanted: str, plans: Sequence[Document]) -> Document:
    """The plan of an id, or of the number of a pull request. RefusalError: the manager remembers none."""
    number = int(wanted.lstrip("#")) if wanted.lstrip("#").isdecimal() else None
    for plan in plans:
        if plan["plan"] == wanted or (number is not None and plan["pull_request"] == number):
            return plan
    raise RefusalError("UnknownPlan", f"the manager remembers no plan {wanted}; see `robotkube plan list`")


def kind_of(wanted: str, tasks: Sequence[Document], plans: Sequence[Document], pods: Sequence[Document]) -> str:
    """What an id is of: one of KINDS. RefusalError: nothing that is there, or that the manager remembers, has it."""
    events = [task.get("spec", {}).get("event", {}) for task in tasks]
    if any(wanted == object_key(task) for task in tasks) or any(wanted in plan["tasks"] for plan in plans):
        return "task"
    if any(wanted == plan["plan"] for plan in plans):
        return PLAN
    of_events = {name for event in events for name in (event.get("id"), event.get("trace"))}
    if wanted in of_events or any(wanted in (*plan["events"], *plan.get("traces", ())) for plan in plans):
        return "event"
    if any(wanted == object_key(pod) for pod in pods):
        return "pod"
    if any(wanted in plan[word] for plan in plans for word in ("created", "changed", "removed")):
        return "release"
    if COMMIT_START.fullmatch(wanted) and any((plan["commit"] or "").startswith(wanted) for plan in plans):
        return "commit"
    known = "`robotkube task list`, `robotkube plan list`; a recording is named by `robotkube open recording NAME`"
    raise RefusalError("UnknownId", f"no event, task, plan, pod, release or commit {wanted} is known; see {known}")


def _without_console(platform: Platform, options: argparse.Namespace) -> str:
    """The forge's page of a plan. RefusalError: there is no console, and what shows the same in the terminal."""
    missing = f"there is no console: namespace {options.platform_namespace} has no Service {CONSOLE}"
    if options.what != PLAN:
        instead = {
            FLEET: "`robotkube watch` shows the fleet in the terminal",
            WHY: f"`robotkube trace {options.id}` lists the same in the terminal",
            RECORDING: f"`robotkube recording show {options.id}` shows it in the terminal",
        }
        raise RefusalError("NoConsole", f"{missing}; {instead[options.what]}")
    plan = named_plan(options.id, platform.page("/plans")["plans"])
    if plan["pull_request"] is None:
        raise RefusalError("NoConsole", f"{missing}, and plan {plan['plan']} has no pull request yet")
    print(f"robotkube: {missing}; this is the forge's page of the plan", file=sys.stderr)
    return _at_forge(platform, plan)


def _at_forge(platform: Platform, plan: Document) -> str:
    """The forge's page of a plan, at the Service of a forge in the cluster: its name, which the plan's own address has,
    is known in the cluster alone. RefusalError: the plan has no pull request yet."""
    if plan["pull_request"] is None:
        raise RefusalError("NoPullRequest", f"plan {plan['plan']} has no pull request yet")
    try:
        forge = platform.forge_url()
    except InputError:
        if plan.get("url"):
            return str(plan["url"])
        raise
    if lacks_pages(forge):
        said = (
            "the forge has no styles and scripts of its pages: `make web` builds them, the next `make demo` serves them"
        )
        print(f"robotkube: {said}; `robotkube trace {plan['plan']}` shows the plan here", file=sys.stderr)
    secret = platform.forge_secret(VIEWER)
    if secret:
        command = f"kubectl {secret} -o jsonpath='{{.data.password}}' | base64 -d"
        print(f"robotkube: sign in as {VIEWER}; the password: {command}", file=sys.stderr)
    return f"{forge}/{DEPLOYMENT}/pulls/{plan['pull_request']}"


def lacks_pages(forge: str) -> bool:
    """Return whether a forge was built without what its pages load; False also when it does not answer from here."""
    try:
        with urllib3.PoolManager() as pool:
            answer = pool.request("GET", forge + PAGES_MADE, timeout=FORGE_SECONDS_MAX, retries=False, redirect=False)
    except urllib3.exceptions.HTTPError:
        return False
    return answer.status == 404
