"""What one suite's process does: read request and settings, fetch the chart, run the suite, give the result."""

from __future__ import annotations

import functools
import json
import os
import secrets
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from robotkube.adapters.helm_program import HelmProgram
from robotkube.adapters.kubernetes_api import api_client, call
from robotkube.adapters.mongo_accounts import MongoAccounts
from robotkube.adapters.oci_registry import Registry
from robotkube.adapters.schemas_jsonschema import violations
from robotkube.adapters.suite_rooms import KubernetesRoomObjects
from robotkube.adapters.templates_jinja2 import Jinja2Templates
from robotkube.domain.charts_packing import canonical_json
from robotkube.domain.errors import InputError, UnavailableError
from robotkube.domain.evidence import SuiteResult
from robotkube.domain.suite_requests import SuiteProgress, SuiteRequest, progress_document, read_request
from robotkube.domain.verification import SuiteRule
from robotkube.entrypoints import settings as files
from robotkube.entrypoints.processes import Process
from robotkube.entrypoints.suite_settings import RunnerConfiguration, read_configuration
from robotkube.ports.suites import Account, Subject, Suite
from robotkube.services.suite_custom import CustomSuite
from robotkube.services.suite_images import ImagesSuite
from robotkube.services.suite_install import InstallSuite
from robotkube.services.suite_interface import InterfaceSuite
from robotkube.services.suite_rooms import ClusterRoom
from robotkube.services.suite_running import NO_ROOM, read_subject, run_suite, unfinished
from robotkube.services.suite_static import StaticSuite

HELM = "/usr/local/bin/helm"
ACCOUNT_SECONDS_MAX, ACCOUNT_PAUSE_SECONDS = 60.0, 0.5


def run_request(payload: bytes, room: str) -> bytes:
    """A request as JSON and the room's namespace (empty: none) -> the finished progress as JSON."""
    found = files.read_settings(files.settings_path(), read_configuration)
    files.send_logs(Process("suite", 0.0), found.log_level)
    result = run(found, read_request(json.loads(payload)), room)
    return canonical_json(progress_document(SuiteProgress("finished", result)))


def run(found: RunnerConfiguration, request: SuiteRequest, room_name: str) -> SuiteResult:
    """The result of the request's suite."""
    account = found.account
    with (
        Registry(found.forge_url, account.username, account.password) as registry,
        tempfile.TemporaryDirectory(prefix="suite-") as work,
    ):
        suite = find_suite(found, request.rule, registry)
        if suite is None:
            words = f"there is no suite {request.rule.name}; one of your own needs `image` in the verification policy"
            return unfinished(request.rule, words, 0.0)
        room = _room(found, room_name, request.rule.seconds) if room_name else None
        program = HelmProgram(os.environ.get("ROBOTKUBE_HELM", HELM), Path(work))
        namespace = room_name or NO_ROOM

        def subject() -> Subject:
            _check_repositories(found, request)
            return read_subject(request, registry, program, namespace)

        return run_suite(request.rule, suite, subject, room, time.monotonic)


def find_suite(found: RunnerConfiguration, rule: SuiteRule, registry: Registry) -> Suite | None:
    """The suite that a rule names; None when there is none."""
    render = Jinja2Templates().render
    if rule.image:
        return CustomSuite(rule, render, time.time_ns)
    host = urlsplit(found.images_registry).netloc
    known: tuple[Suite, ...] = (
        StaticSuite(violations, render),
        ImagesSuite(registry, host, render),
        InterfaceSuite(found.observer_image, render, time.time_ns, functools.partial(secrets.token_hex, 8)),
        InstallSuite(render, time.time_ns),
    )
    return next((suite for suite in known if suite.name == rule.name), None)


def _check_repositories(found: RunnerConfiguration, request: SuiteRequest) -> None:
    named = {"repository": (request.repository, found.staging)}
    if request.replaced:
        named["replaced.repository"] = (request.replaced.repository, found.verified)
    for key, (repository, charts) in named.items():
        organisation = urlsplit(charts).path.strip("/")
        if repository.rpartition("/")[0] != organisation:
            raise InputError(f"{key}: {repository!r} must be in {organisation}")


def _room(found: RunnerConfiguration, name: str, seconds: float) -> ClusterRoom:
    settings = next(room for room in found.rooms if room.namespace == name)
    return ClusterRoom(room_objects(name), settings, seconds, make_account)


def room_objects(namespace: str, environment: Mapping[str, str] = os.environ) -> KubernetesRoomObjects:
    """A room's objects, with the pod's own account, or with KUBECONFIG where that is set."""
    api = api_client(environment.get("KUBECONFIG"), in_cluster="KUBECONFIG" not in environment)
    return KubernetesRoomObjects(functools.partial(call, api), namespace)


def make_account(administrator: Account, account: Account) -> None:
    """An account in a database that was just started; UnavailableError when it does not answer in time."""
    accounts = MongoAccounts(administrator.host, administrator.port, administrator.username, administrator.password)
    deadline = time.monotonic() + ACCOUNT_SECONDS_MAX
    try:
        while True:
            try:
                accounts.make_account(account.database, account.username, account.password)
                return
            except UnavailableError:
                if time.monotonic() >= deadline:
                    raise
                time.sleep(ACCOUNT_PAUSE_SECONDS)
    finally:
        accounts.disconnect()
