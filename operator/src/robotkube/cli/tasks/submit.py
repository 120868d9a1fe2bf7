"""The command `robotkube task submit`: ask for an application, by a file or by options, and wait for the outcome."""

from __future__ import annotations

import argparse
import getpass
import secrets
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.tasks.listing import row
from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.delivery.tasks.core.mqtt_messages import own_event
from robotkube.delivery.tasks.core.refusal_outlooks import without_outlook
from robotkube.delivery.tasks.core.task_description import GROUP, INVALID_PARAMETERS, POSTPONED, VERSION
from robotkube.delivery.tasks.core.task_states import task_state
from robotkube.errors import DocumentError, InputError, RefusalError, UnavailableError, did_you_mean
from robotkube.foundation.documents.core.patterns import PARAMETER_KEY
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.documents.core.yaml_codec import read_mapping

SUBMITTED = "submitted"
POLICIES = ("Reject", "Postpone", "Offload", "Preempt")
POLL_SECONDS = 0.5
WAIT_SECONDS_MAX = 3600.0
WAIT_SECONDS = 600.0
FILE_BYTES_MAX = 256 * 1024


def describing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that describe a task."""
    parser.add_argument("-f", "--file", metavar="FILE", help="TaskDescription in YAML or JSON; - for stdin")
    parser.add_argument("--namespace", default="", help="agent in whose name it is asked for (default: the file's)")
    parser.add_argument("--name", default="", help="its id (default: the application's name and a random end)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--application", default="", help="application of the catalogue")
    what.add_argument("--provides", default="", metavar="WORD", help="what an application has to provide instead")
    parser.add_argument(
        "--parameter", action="append", default=[], metavar="KEY=VALUE", help="parameter, its value in YAML; repeatable"
    )
    parser.add_argument("--priority", type=int, metavar="NUMBER", help="0 to 1000, the higher wins (default: 100)")
    parser.add_argument("--lease", type=int, metavar="SECONDS", help="counts so long unless renewed (default: no end)")
    parser.add_argument("--policy", choices=POLICIES, help="what becomes of it in a conflict (default: Reject)")
    parser.add_argument("--reason", metavar="TEXT", help="one line for people; the subject of the commit")
    parser.add_argument("--requester", default="", help="who asks (default: the file's, else your user name)")


def submitting(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `task submit`."""
    describing(parser)
    parser.add_argument(
        "--wait",
        type=float,
        nargs="?",
        const=WAIT_SECONDS,
        metavar="SECONDS",
        help=f"until it is ready (exit code 0) or refused (1), at most {WAIT_SECONDS_MAX:.0f}, "
        f"{WAIT_SECONDS:.0f} without a number; 3 when it is neither in time",
    )
    parser.add_argument(
        "--delete-if-refused",
        action="store_true",
        help="with --wait: withdraw it again when it is refused, unless it was there before",
    )
    parser.add_argument("--dry-run", action="store_true", help="only have the API server check it; see task explain")


def submit_task(options: argparse.Namespace) -> Table | None:
    """Submit the task, or change the one of this name; the same again changes nothing."""
    if options.wait is not None and not 0 < options.wait <= WAIT_SECONDS_MAX:
        raise InputError(f"--wait {options.wait:g}: give seconds above 0, at most {WAIT_SECONDS_MAX:.0f}")
    if options.delete_if_refused and options.wait is None:
        raise InputError("--delete-if-refused: needs --wait, which sees whether it is refused")
    document = described(options, time.time_ns())
    platform = Platform(options)
    metadata = document["metadata"]
    key = f"{metadata['namespace']}/{metadata['name']}"
    done = _write(platform, document, options.dry_run)
    print(f"{'would be ' if options.dry_run else ''}{done}: {key}", file=sys.stderr)
    if options.dry_run:
        return None
    if options.wait is None:
        return Table("task", (), [{"task": key}], single=True)
    try:
        table = _wait(platform, key, options.wait)
    except KeyboardInterrupt:
        print(f"the task stays; to take it back: robotkube task withdraw {key}", file=sys.stderr)
        raise
    if table.refusal and options.delete_if_refused:
        _delete_refused(platform, key, is_ours=done == SUBMITTED)
    return table


def _delete_refused(platform: Platform, key: str, is_ours: bool) -> None:
    if not is_ours:
        print(f"not withdrawn, since it was there before: {key}", file=sys.stderr)
        return
    platform.withdraw(key, dry_run=False)
    print(f"withdrawn, since it was refused: {key}", file=sys.stderr)


def described(options: argparse.Namespace, now_ns: int) -> dict[str, Any]:
    """The TaskDescription that the options describe; options stand above the file. InputError names what is missing."""
    document = _read_file(options.file) if options.file else {}
    metadata = _part(document, "metadata")
    spec = {**_part(document, "spec"), **_options(options)}
    namespace = options.namespace or metadata.get("namespace", "")
    if not namespace:
        raise InputError("--namespace: name the agent in whose name it is asked for, such as cloud-0")
    if not spec.get("application") and not spec.get("provides"):
        raise InputError("--application: name one (or --provides, or a file); see `robotkube registry search`")
    what = str(spec.get("application") or spec["provides"]).replace("/", "-")
    name = options.name or metadata.get("name") or f"{what}-{secrets.token_hex(3)}"
    requester = options.requester or spec.get("requester") or _user()
    spec = {"event": own_event(namespace, name, time_text(now_ns)), **spec, "requester": requester}
    kept = {key: metadata[key] for key in ("labels", "annotations") if key in metadata}
    head = {"apiVersion": f"{GROUP}/{VERSION}", "kind": "TaskDescription"}
    return {**head, "metadata": {**kept, "namespace": namespace, "name": name}, "spec": spec}


def _read_file(name: str) -> Mapping[str, Any]:
    try:
        text = sys.stdin.read(FILE_BYTES_MAX + 1) if name == "-" else Path(name).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"--file {name}: {error}") from error
    document = read_mapping(text, name)
    unknown = sorted(set(document) - {"apiVersion", "kind", "metadata", "spec", "status"})
    kind = document.get("kind", "TaskDescription")
    problems = [f"{key}: unknown key; remove it" for key in unknown]
    problems += [] if kind == "TaskDescription" else [f"kind: {kind!r} must be 'TaskDescription'"]
    if problems:
        raise DocumentError(name, problems)
    return document


def _part(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = document.get(key, {})
    if not isinstance(part, Mapping):
        raise InputError(f"{key}: must be a mapping")
    return part


def _options(options: argparse.Namespace) -> dict[str, Any]:
    """The parts of the spec that the options state."""
    spec: dict[str, Any] = {
        "application": options.application or None,
        "provides": options.provides or None,
        "parameters": _parameters(options.parameter) or None,
        "priority": options.priority,
        "lease": None if options.lease is None else {"seconds": options.lease},
        "conflictPolicy": options.policy,
        "reason": options.reason,
    }
    return {key: value for key, value in spec.items() if value is not None}


def _parameters(texts: Sequence[str]) -> dict[str, Any]:
    parameters = {}
    for text in texts:
        key, separator, value = text.partition("=")
        if not separator or not PARAMETER_KEY.fullmatch(key):
            raise InputError(f"--parameter {text!r}: write KEY=VALUE, such as vehicles=[vehicle-00, vehicle-01]")
        parameters[key] = read_mapping(f"value: {value}", f"--parameter {key}")["value"]
    return parameters


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return "somebody"


def _write(platform: Platform, document: Mapping[str, Any], dry_run: bool) -> str:
    writer = platform.task_writer(dry_run)
    metadata = document["metadata"]
    present = writer.find(metadata["namespace"], metadata["name"])
    if present is None:
        _check(platform, document, "Nothing was submitted")
        if _create(platform, writer, document):
            return SUBMITTED
        present = writer.find(metadata["namespace"], metadata["name"])
    if present is None:
        raise RefusalError("UnknownTask", f"{metadata['name']} was withdrawn meanwhile; submit it again")
    present_spec = present["spec"]
    spec = {**document["spec"], **{key: present_spec[key] for key in ("event", "chain") if key in present_spec}}
    if spec == present_spec:
        return "unchanged"
    runs = ", and what runs for the task goes on" if present.get("status", {}).get("releases") else ""
    _check(platform, {**document, "spec": spec}, f"Nothing was changed{runs}")
    writer.patch_spec(metadata["namespace"], metadata["name"], spec)
    return "changed"


def _create(platform: Platform, writer: KubernetesTasks, document: Mapping[str, Any]) -> bool:
    """Return whether the task was created. InputError says which agent was meant, when the namespace is like another
    one."""
    try:
        return writer.create(document)
    except InputError as error:
        namespace = document["metadata"]["namespace"]
        known = platform.agents()
        instead = "" if namespace in known else did_you_mean(namespace, known).strip()
        raise InputError(f"{error}; {instead}" if instead else str(error)) from error


def _check(platform: Platform, document: Mapping[str, Any], what_is_so: str) -> None:
    """RefusalError when the manager would refuse the parameters, with what is so then: of a task that is there, what
    runs for it would be withdrawn. Where no manager can be asked, it decides later."""
    try:
        answer = platform.explain(document)
    except (InputError, UnavailableError) as error:
        print(f"the manager was not asked first: {error}", file=sys.stderr)
        return
    if answer["outcome"] == "Refused" and answer["reason"] == INVALID_PARAMETERS:
        words = without_outlook(INVALID_PARAMETERS, answer["message"])
        raise RefusalError(INVALID_PARAMETERS, f"{words}. {what_is_so}")


def _wait(platform: Platform, key: str, seconds: float) -> Table:
    """Wait until the task is ready; refused when it is refused, late when it is neither in time. One that is postponed
    waits for its place."""
    end = time.monotonic() + seconds
    while True:
        task = platform.task(key)
        conditions = {c["type"]: c for c in task.get("status", {}).get("conditions", [])}
        now = task["metadata"].get("generation") == task.get("status", {}).get("observedGeneration")
        accepted = conditions.get("Accepted", {})
        ready = conditions.get("Ready", {})
        if now and accepted.get("status") == "False" and accepted.get("reason") != POSTPONED:
            text = f"{accepted['reason']}: {accepted['message']}"
            return Table("task", (), [row(task)], single=True, refusal=text)
        if now and ready.get("status") == "True":
            return Table("task", (), [row(task)], single=True)
        if time.monotonic() > end:
            why = ready.get("message", "") if now else ""
            text = f"not ready within {seconds:g} s: {task_state(task)}{f'; {why}' if why else ''}"
            return Table("task", (), [row(task)], single=True, unreachable=text)
        time.sleep(POLL_SECONDS)
