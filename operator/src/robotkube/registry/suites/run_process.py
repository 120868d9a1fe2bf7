"""The process of one suite: it reads request and settings, fetches the chart, runs the suite, gives the result."""

from __future__ import annotations

import functools
import json
import os
import random
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from urllib.parse import urlsplit

from robotkube.backoffs import backoff
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.database.adapters.accounts import MongoAccounts
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.kubernetes.adapters.client import api_client, call
from robotkube.foundation.kubernetes.adapters.http_client import ACCOUNT_FOLDER
from robotkube.foundation.kubernetes.adapters.kubelet_client import KubeletClient
from robotkube.foundation.runtime import settings_file as files
from robotkube.foundation.runtime.process import Process
from robotkube.registry.charts.adapters.helm import PROGRAM, PROGRAM_VARIABLE, HelmProgram
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.evidence.core.verification_policy import SuiteRule
from robotkube.registry.suites.adapters.kubelet_memory import RIGHT, TIMEOUT_SECONDS, KubeletMemory
from robotkube.registry.suites.adapters.namespace_objects import KubernetesNamespaceObjects
from robotkube.registry.suites.cluster_suites import install_suite, interface_suite
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest, progress_document, read_request
from robotkube.registry.suites.loops.cluster_namespace import ClusterTestNamespace
from robotkube.registry.suites.loops.custom import CustomSuite
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.loops.install import InstallSuite
from robotkube.registry.suites.loops.installed.memory_sampling import MemoryWatch
from robotkube.registry.suites.loops.interface import InterfaceSuite
from robotkube.registry.suites.loops.run import NO_NAMESPACE, read_subject, run_suite, unfinished
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.plain_suites import images_suite, static_suite
from robotkube.registry.suites.ports.suites import Subject, Suite, SuiteAccount
from robotkube.registry.suites.settings import FORMER_KEYS, RunnerConfiguration, read_configuration

ACCOUNT_SECONDS_MAX = 60.0
ACCOUNT_PAUSE_SECONDS_FIRST, ACCOUNT_PAUSE_SECONDS_MAX = 0.5, 1.0


def run_request(payload: bytes, namespace: str) -> bytes:
    """A request as JSON and a test namespace (empty: none) -> the finished progress as JSON."""
    configuration = files.read_settings(files.settings_path(), read_configuration, FORMER_KEYS)
    files.send_logs(Process("suite", 0.0), configuration.log_level)
    trust(configuration.authorities)
    result = run(configuration, read_request(json.loads(payload)), namespace)
    return canonical_json(progress_document(SuiteProgress("finished", result)))


def run(configuration: RunnerConfiguration, request: SuiteRequest, namespace: str) -> SuiteResult:
    """The result of the request's suite in the test namespace (empty: none)."""
    account = configuration.account
    with (
        OciRegistry(configuration.forge_url, account.username, account.password) as oci_registry,
        tempfile.TemporaryDirectory(prefix="suite-") as work,
    ):
        suite = find_suite(configuration, request.rule, oci_registry)
        if suite is None:
            words = f"there is no suite {request.rule.name}; one of your own needs `image` in the verification policy"
            return unfinished(request.rule, words, 0.0)
        test_namespace = _test_namespace(configuration, namespace, request.rule.seconds) if namespace else None
        program = HelmProgram(os.environ.get(PROGRAM_VARIABLE, PROGRAM), Path(work))

        def subject() -> Subject:
            _check_repositories(configuration, request)
            return read_subject(request, oci_registry, program, namespace or NO_NAMESPACE)

        return run_suite(request.rule, suite, subject, test_namespace, time.monotonic)


def find_suite(configuration: RunnerConfiguration, rule: SuiteRule, oci_registry: OciRegistry) -> Suite | None:
    """The suite that a rule names; None when there is none."""
    if rule.image:
        return CustomSuite(rule, Jinja2Templates().render, time.time_ns)
    observer = configuration.observer_image
    known: dict[str, Callable[[], Suite]] = {
        StaticSuite.name: static_suite,
        ImagesSuite.name: lambda: images_suite(oci_registry, urlsplit(configuration.images_registry).netloc),
        InterfaceSuite.name: lambda: interface_suite(observer),
        InstallSuite.name: lambda: install_suite(observer, rule.soak_seconds, _memory(configuration, rule)),
    }
    return known[rule.name]() if rule.name in known else None


def _memory(configuration: RunnerConfiguration, rule: SuiteRule) -> MemoryWatch:
    authority = ACCOUNT_FOLDER / "ca.crt" if configuration.verify_kubelets else None
    kubelets = KubeletClient(RIGHT, authority, timeout_seconds=TIMEOUT_SECONDS)
    return MemoryWatch(KubeletMemory(kubelets), rule.memory_growth_percent, time.time)


def _check_repositories(configuration: RunnerConfiguration, request: SuiteRequest) -> None:
    named = {"repository": (request.repository, configuration.staging)}
    if request.replaced:
        named["replaced.repository"] = (request.replaced.repository, configuration.verified)
    for key, (repository, charts) in named.items():
        organisation = urlsplit(charts).path.strip("/")
        if repository.rpartition("/")[0] != organisation:
            raise InputError(f"{key}: {repository!r} must be in {organisation}")


def _test_namespace(configuration: RunnerConfiguration, name: str, seconds: float) -> ClusterTestNamespace:
    settings = next(known for known in configuration.test_namespaces if known.namespace == name)
    return ClusterTestNamespace(namespace_objects(name), settings, seconds, make_account)


def namespace_objects(namespace: str, environment: Mapping[str, str] = os.environ) -> KubernetesNamespaceObjects:
    """The objects of a test namespace, reached with the pod's own account, or with KUBECONFIG where that is set."""
    api = api_client(environment.get("KUBECONFIG"), in_cluster="KUBECONFIG" not in environment)
    return KubernetesNamespaceObjects(functools.partial(call, api), namespace)


def make_account(administrator: SuiteAccount, account: SuiteAccount) -> None:
    """An account in a database that was just started; UnavailableError when it does not answer in time."""
    with tempfile.TemporaryDirectory(prefix="database-") as folder:
        _make_account(_accounts(administrator, Path(folder)), account)


def _accounts(administrator: SuiteAccount, folder: Path) -> MongoAccounts:
    """The database of a test namespace, by its administrator; who signed its certificate is written into `folder`."""
    tls = None
    if administrator.authority:
        tls = ServerVerification(folder / "ca.crt", administrator.server_name)
        tls.authorities.write_text(administrator.authority)
    known = administrator
    return MongoAccounts(known.host, known.port, known.username, known.password, tls)


def _make_account(accounts: MongoAccounts, account: SuiteAccount) -> None:
    deadline = time.monotonic() + ACCOUNT_SECONDS_MAX
    attempts = 0
    try:
        while True:
            try:
                accounts.make_account(account.database, account.username, account.password)
                return
            except UnavailableError:
                if time.monotonic() >= deadline:
                    raise
                bounds = ACCOUNT_PAUSE_SECONDS_FIRST, ACCOUNT_PAUSE_SECONDS_MAX
                time.sleep(backoff(attempts, *bounds, random.random))
                attempts += 1
    finally:
        accounts.disconnect()
