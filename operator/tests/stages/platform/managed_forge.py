"""A Gitea of others, in a namespace of its own beside the platform: what docs/how-to/use-another-forge.md has one make
there is made by its administrator."""

from __future__ import annotations

import os
import re
import secrets
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from ci import publish
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.nodes import pulling
from ci.folders import PROJECT
from ci.images import preparation
from ci.images.image_lock import Image
from ci.installation import GATE, RESTRICTED
from ci.installation import NAMESPACE as PLATFORM
from robotkube.delivery.preflight.core.values import merged
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap, ForgeAccount, ForgeSetup, Organisation, Repository, Webhook
from tests.stages.forge.gitea import APP_INI, HOOKS, RIGHTS
from tests.stages.paths import DOCS
from tests.stages.platform.managed_services import NAMESPACE, READY_SECONDS, secret_object, served
from tests.stages.platform.running_platform import NAME, Platform

PAGE = DOCS / "how-to" / "use-another-forge.md"
BLOCK = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PORT = 3000
HOST = f"git.{NAMESPACE}.svc.cluster.local:{PORT}"
ADMINISTRATOR = ("owner", "known-to-nobody-else")
SEEDS = PROJECT / "gitops"
BRANCH = "main"
MAKING_SECONDS_MAX, LOOK_SECONDS = 180.0, 1.0
PROGRAM = """
forge() { gitea --config /etc/gitea/app.ini "$@"; }
forge migrate
forge admin user create --admin --username "$NAME" --password "$PASSWORD" --email owner@forge.invalid \
  --must-change-password=false
exec gitea --config /etc/gitea/app.ini web
"""


def examples() -> tuple[dict[str, Any], dict[str, Any]]:
    """The page's values, and what one makes on the forge."""
    values, made = (yaml.safe_load(text) for text in BLOCK.findall(PAGE.read_text(encoding="utf-8")))
    return values, made


def values() -> dict[str, Any]:
    """The page's values with this forge, which speaks HTTP as the platform's processes do, so that its webhooks need no
    authority; and from where it calls them."""
    given, _ = examples()
    given["forge"]["external"] = {"url": f"http://{HOST}", "protocol": "gitea"}
    named = {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": NAMESPACE}}}
    given["networkPolicies"]["outside"]["to"] = [named]
    machine = {"ipBlock": {"cidr": f"{plan_of(NAME).gateway}/32"}}
    clients = {"gate": [named], "manager": [machine, named], "rights": [named]}
    return merged(given, {"tls": {"processes": False}, "networkPolicies": {"clients": clients}})


def images_there() -> tuple[Image, ...]:
    """All images, by the names that they have at this forge."""
    prefix = f"{HOST}/robotkube"
    return tuple(
        replace(one, reference=f"{prefix}/{one.name}@{one.reference.partition('@')[2]}")
        for one in preparation.everything().images
    )


@dataclass(frozen=True)
class ManagedForge:
    """The forge and who owns it."""

    platform: Platform

    def start(self) -> None:
        """Run it, with no account but the owner's."""
        self.platform.installer.namespace(NAMESPACE, RESTRICTED)
        hooks = {path.name: path.read_text(encoding="utf-8") for path in HOOKS.iterdir()}
        objects = [
            secret_object("git-settings", NAMESPACE, {"app.ini": _settings()}),
            secret_object("git-hooks", NAMESPACE, hooks),
            *_forge(preparation.everything().references()["gitea"]),
        ]
        self.platform.kubectl("apply", "--server-side", "-f", "-", text=yaml.safe_dump_all(objects))
        wait = ("-n", NAMESPACE, "rollout", "status", "deployment/git", f"--timeout={READY_SECONDS}s")
        self.platform.kubectl(*wait, seconds=READY_SECONDS + 10)

    def argocd(self) -> None:
        """Argo CD once more, with policies that let it reach this forge."""
        own = self.platform.installer
        profile = replace(own.profile, values=merged(own.profile.values, values()))
        replace(own, profile=profile).argocd(preparation.everything().references())

    @contextmanager
    def being_made(self) -> Iterator[None]:
        """Make what the page says, as soon as the Secrets with passwords are there."""
        failed: list[BaseException] = []

        def make() -> None:
            try:
                self._make()
            except BaseException as error:
                failed.append(error)

        making = threading.Thread(target=make)
        making.start()
        yield
        making.join()
        if failed:
            raise failed[0]

    def _make(self) -> None:
        _, page = examples()
        self._until_there(GATE, "forge-webhook-gate")
        self._until_there(PLATFORM, "forge-webhook-rights")
        address = self.platform.access.service("git", NAMESPACE)[0].address
        administration = GiteaAdministration(f"http://{address}:{PORT}", *ADMINISTRATOR)
        try:
            Bootstrap(MAKING_SECONDS_MAX, time.monotonic, time.sleep).forge(self._setup(page), administration)
        finally:
            administration.disconnect()

    def _setup(self, page: Mapping[str, Any]) -> ForgeSetup:
        access = [*page["repositories"].values(), *page["packages"].values()]
        accounts = sorted({name for one in access for name in one})
        hooks = [(name, to, events) for name, of in page["webhooks"].items() for to, events in of.items()]
        return ForgeSetup(
            accounts=tuple(ForgeAccount(name, self._value("account", name, "password")) for name in accounts),
            organisations=tuple(Organisation(name, who) for name, who in page["packages"].items()),
            repositories=tuple(
                Repository(name, name, BRANCH, _seed(name.rpartition("/")[2]), who, ("gate",))
                for name, who in page["repositories"].items()
            ),
            webhooks=tuple(
                Webhook(name, _address(to), tuple(events), self._value("webhook", to, "secret"))
                for name, to, events in hooks
            ),
        )

    def _value(self, kind: str, name: str, key: str) -> str:
        """What the chart has made for it, where the page says that it stands."""
        return self.platform.access.secret(GATE if name == "gate" else PLATFORM, f"forge-{kind}-{name}")[key]

    def _until_there(self, namespace: str, name: str) -> None:
        asked = ("-n", namespace, "get", "secret", name, "--ignore-not-found", "-o", "name")
        end = time.monotonic() + MAKING_SECONDS_MAX
        while not self.platform.kubectl(*asked) and time.monotonic() < end:
            time.sleep(LOOK_SECONDS)

    def pulled_from(self) -> None:
        """Have every node pull images of this forge, whose name it cannot resolve."""
        nodes = publish.find_forge(self.platform.installer.kubeconfig, publish.PULL_ACCOUNT)
        pulling.allow(self.platform.provider.folders.hosts, nodes.url, nodes.username, nodes.password, host=HOST)


def _settings() -> str:
    """Those of the tests' forges, for a pod; every key that Gitea would write there itself is given."""
    text = APP_INI.format(
        user="robotkube", data="/data", port=PORT, url=f"http://{HOST}", static="/opt/gitea",
        secret=secrets.token_hex(32), token=secrets.token_hex(32), hooks="/etc/forge-hooks",
        rights=RIGHTS.read_text(encoding="utf-8").strip(),
    )  # fmt: skip
    own = {
        f"LOCAL_ROOT_URL = http://{HOST}/": f"LOCAL_ROOT_URL = http://127.0.0.1:{PORT}/",
        "ADDR = 127.0.0.1": "ADDR = 0.0.0.0",
    }
    for ours, of_pod in own.items():
        assert ours in text
        text = text.replace(ours, of_pod)
    return f"{text}[oauth2]\nENABLED = false\nJWT_SECRET = {secrets.token_urlsafe(32)}\n"


def _address(process: str) -> str:
    namespace = GATE if process == "gate" else PLATFORM
    return f"http://{process}.{namespace}.svc.cluster.local:8080/webhook"


def _seed(folder: str) -> dict[str, bytes]:
    """The files of a folder of gitops, those of links included."""
    root = SEEDS / folder
    files = [Path(place) / name for place, _, names in os.walk(root, followlinks=True) for name in names]
    return {file.relative_to(root).as_posix(): file.read_bytes() for file in files}


def _forge(image: str) -> list[dict[str, Any]]:
    volumes = {
        "/etc/gitea": {"secret": {"secretName": "git-settings", "defaultMode": 0o440}},
        "/etc/forge-hooks": {"secret": {"secretName": "git-hooks", "defaultMode": 0o550}},
        "/data": {"emptyDir": {}},
        "/tmp": {"emptyDir": {}},  # noqa: S108 - of the pod
    }
    names = zip(("NAME", "PASSWORD"), ADMINISTRATOR, strict=True)
    environment = [{"name": name, "value": value} for name, value in (*names, ("HOME", "/data"), ("USER", "robotkube"))]
    container = {"image": image, "command": ["sh", "-ec", PROGRAM], "env": environment}
    return served("git", PORT, container, volumes)
