"""The gate's publication on the tests' forge, and submissions to it as the command makes them."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.cli.registry.submit import CATALOGUE, ForgeAccess, submit_sources
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.publication.adapters.submission_folders import validation_tools
from robotkube.registry.publication.loops import publication, submitting
from robotkube.registry.publication.loops.application_verification import ApplicationVerification
from robotkube.registry.publication.loops.publication import PublicationLoop
from robotkube.registry.publication.loops.submission_reader import PublicationSettings
from robotkube.registry.publication.loops.submitting import SubmissionOutcome
from robotkube.registry.publication.loops.verification import ChartVerification, VerifyingSettings
from robotkube.registry.publication.ports import ApplicationTrials, ChartSource, SubmittedSources
from robotkube.testing.publishing import ScriptedRunner, ScriptedTrials
from tests.stages.forge.catalogue_evidence import gate_key, trusted_keys
from tests.stages.forge.installation import CHARTS_URL, Installation
from tests.stages.paths import REPOSITORY
from tests.stages.registry.submissions import IMAGE

WAIT_SECONDS = 60.0
END_SECONDS_MAX = 20.0
LOOK_SECONDS = 0.2


@dataclass
class Publishing:
    """A gate's publication on the forge, and what it talks to; `start` and `stop` as often as wanted."""

    installation: Installation
    folder: Path
    runner: ScriptedRunner = field(default_factory=ScriptedRunner)
    trials: ApplicationTrials = field(default_factory=ScriptedTrials)
    local_builds: bool = False
    lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._running: tuple[PublicationLoop, threading.Thread, threading.Event] | None = None
        self._made = 0

    def make(self) -> PublicationLoop:
        """A gate that was just started, on clones of its own; nothing runs yet."""
        self._made += 1
        url = self.installation.url
        account = ("gate", self.installation.passwords["gate"])
        folder = self.folder / f"gate-{self._made}"
        clone = GitClone(url, CATALOGUE, *account, folder)
        self.registry = OciRegistry(url, *account)
        names = VerifyingSettings("staging", "verified", CHARTS_URL, f"{url}/{CATALOGUE}", "gate-of-tests")
        verifying = ChartVerification(
            self.registry,
            gate_key(),
            trusted_keys(),
            self.runner,
            names,
            time.monotonic,
            lambda: "2026-11-21T10:00:00Z",
        )
        return PublicationLoop(
            GiteaForge(url, CATALOGUE, *account),
            clone,
            ProposalWriter(folder, *account, "gate", time.time),
            self.registry,
            verifying,
            ApplicationVerification(self.trials, gate_key(), trusted_keys()),
            gate_key(),
            PublicationSettings(
                CATALOGUE, ("publisher",), "gate", "staging", "verified", CHARTS_URL, self.local_builds
            ),
            validation_tools(),
            time.monotonic,
        )

    def start(self) -> None:
        loop = self.make()
        stopping = threading.Event()
        thread = threading.Thread(target=loop.run, args=(stopping,), daemon=True)
        thread.start()
        self._running = (loop, thread, stopping)

    def stop(self) -> None:
        if self._running is not None:
            loop, thread, stopping = self._running
            loop.stop(stopping)
            thread.join(END_SECONDS_MAX)
            assert not thread.is_alive()
            disconnect(loop)
            self.registry.disconnect()
            self._running = None

    def submit(
        self,
        *charts: tuple[Any, Any],
        dry_run: bool = False,
        opened: Callable[[PullRequest], None] = lambda pull: None,
        **more: Any,
    ) -> SubmissionOutcome:
        """As the command does it, with these charts; `opened` is called with the pull request."""
        document = {"apiVersion": "registry.robotkube.io/v1alpha1", "kind": "ChartVersion"}
        sources = tuple(
            ChartSource({**document, "metadata": {"name": packed.name}, "spec": spec}, packed, (IMAGE,))
            for packed, spec in charts
        )
        access = ForgeAccess(self.installation.url, "publisher", self.installation.passwords["publisher"])
        return submit_sources(access, SubmittedSources(sources, **more), self.say, WAIT_SECONDS, dry_run, opened=opened)

    def say(self, line: str) -> None:
        """What the command says; the gate hears of a new pull request as by the forge's webhook."""
        self.lines.append(line)
        if line.startswith("pull request") and self._running is not None:
            event = {"action": "opened", "repository": {"full_name": CATALOGUE}}
            self._running[0].wake("pull_request", event)

    def main(self) -> dict[str, str]:
        """The catalogue's files."""
        clone = self.installation.clone("operator-team", CATALOGUE)
        tree = clone.repository[clone.tip()].tree
        index: dict[str, str] = {}
        _collect(clone.repository, tree, "", index)
        return index


def look_often(patch: pytest.MonkeyPatch) -> None:
    """Gate and command of this process ask each other at once, as far as nobody tells them: nothing is shown by how
    long they wait."""
    patch.setattr(publication, "BUSY_SECONDS", LOOK_SECONDS)
    patch.setattr(publication, "POLL_SECONDS", 2 * LOOK_SECONDS)
    patch.setattr(submitting, "POLL_SECONDS", LOOK_SECONDS)


def disconnect(loop: PublicationLoop) -> None:
    """Close the connections of a loop that was made here to the forge."""
    forge = loop._forge
    assert isinstance(forge, GiteaForge)
    forge.disconnect()


def _collect(repository: Any, tree: Any, prefix: str, found: dict[str, str]) -> None:
    for entry in tree:
        if entry.type_str == "tree":
            _collect(repository, repository[entry.id], f"{prefix}{entry.name}/", found)
        else:
            found[prefix + entry.name] = repository[entry.id].data.decode()


def write_sources(folder: Path, name: str, *more: str) -> None:
    """What `registry new` writes (with more options), beside the library chart."""
    library = REPOSITORY / "charts" / "apps" / "robotkube-app"
    shutil.copytree(library, folder / "charts" / "apps" / library.name)
    shutil.copytree(REPOSITORY / "registry" / "policies", folder / "registry" / "policies")
    for place in ("applications", "charts"):
        (folder / "registry" / place).mkdir(parents=True)
    where = ["--charts", str(folder / "charts" / "apps"), "--registry", str(folder / "registry")]
    assert cli.main(["registry", "new", name, *more, *where]) == 0
