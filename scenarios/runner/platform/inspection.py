"""Commands with which a person inspects the cluster after a run, to be pasted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ci.folders import user_cache
from scenarios.definition import Scenario
from scenarios.runner.platform.access import Endpoint

PASSWORD = "$(kubectl -n robotkube get secret forge-account-{person} -o jsonpath={{.data.password}} | base64 -d)"  # noqa: S105
AUTHORITY = "robotkube-ca.crt"
READING_AUTHORITY = r"kubectl -n robotkube get configmap robotkube-ca -o jsonpath='{.data.ca\.crt}'"
ROBOTKUBE = "ci/python -m robotkube.cli"
WEB_PAGES = (
    f"`{ROBOTKUBE} open plan N --forge` opens a pull request's page at the forge, and says so when `make web` has not "
    "built what it loads. Argo CD's pages cannot be built here; the commands above show the same."
)
SEEING = (
    f"`{ROBOTKUBE} watch` shows what happens as it happens, until ctrl-C; `{ROBOTKUBE} open fleet` opens the console, "
    "or says what shows the same."
)


def kubectl_folder() -> Path | None:
    """The folder of the tool chain's kubectl that was used last; None when there is none."""
    folders = [path.parent for path in (user_cache() / "toolchain").glob("*/bin/kubectl")]
    return max(folders, key=lambda folder: folder.parent.stat().st_mtime, default=None)


def commands(scenario: Scenario, kubeconfig: Path, forge: Endpoint, meanwhile: str = "") -> Iterator[tuple[str, str]]:
    """Pairs of what a command shows and the command; each ends by itself, but for the one that the forge's address
    needs meanwhile, if there is one."""
    person, agent = scenario.story.person, scenario.story.recording_agent
    scheme, _, place = forge.url.partition("//")
    clone = f"{scheme}//{person}:{PASSWORD.format(person=person)}@{place}/robotkube/deployment.git"
    # By the environment: it counts more than http.sslCAInfo, and some machines have it set.
    believing = f"GIT_SSL_CAINFO={AUTHORITY} " if forge.encrypted else ""
    programs = kubectl_folder()
    path = f' PATH="{programs}:$PATH"' if programs else ""
    yield "use this cluster (in the project's folder)", f"export KUBECONFIG={kubeconfig}{path}"
    yield "machines and their roles", "kubectl get nodes -L robotkube.io/role -L robotkube.io/agent"
    yield "pods of all agents", "kubectl get pods -A -l robotkube.io/agent -o wide"
    yield "what Argo CD runs", "kubectl -n argocd get applications"
    yield "what was planned, with times and pull requests", f"{ROBOTKUBE} plan list"
    yield "what main asks for and what the cluster shows", f"{ROBOTKUBE} release list"
    yield "tasks (one while two vehicles that drive on are near each other)", f"{ROBOTKUBE} task list"
    if agent:
        yield "what was recorded", f"{ROBOTKUBE} recording list"
        yield (
            "what the recorder's account may do",
            f"kubectl auth can-i --list -n {agent} --as system:serviceaccount:{agent}:event-detector",
        )
    if forge.encrypted:
        yield "who signed the forge's certificate", f"{READING_AUTHORITY} > {AUTHORITY}"
    if meanwhile:
        yield "the way to the forge, for as long as it runs", meanwhile
    yield "the deployment repository", f'{believing}git clone "{clone}" deployment'
    yield "every change with its cause", "git -C deployment log --format='%h %an %s%n%(trailers)'"


def lines(scenario: Scenario, kubeconfig: Path, forge: Endpoint, meanwhile: str = "") -> Iterator[str]:
    """The commands as text, and how pages are seen."""
    yield "To inspect the cluster:"
    for what, command in commands(scenario, kubeconfig, forge, meanwhile):
        yield f"  # {what}"
        yield f"  {command}"
    yield SEEING
    yield WEB_PAGES
