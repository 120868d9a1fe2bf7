"""The command line on a real API server: data on stdout, talk on stderr, exit codes."""

import argparse
import io
import json
import time
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TextIO

import pytest

from robotkube.cli.main import main
from robotkube.cli.platform import Platform
from robotkube.cli.tasks import submit, watch
from robotkube.errors import InputError
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.programs import free_port

pytestmark = pytest.mark.toolchain


class Line:
    """Runs commands with access to the test's server."""

    def __init__(self, api_server: ApiServerProcess, capture: pytest.CaptureFixture[str]) -> None:
        self._access = ["--kubeconfig", str(api_server.kubeconfig)]
        self._capture = capture

    def run(self, *words: str) -> tuple[int, str, str]:
        code = main([*words[:2], *self._access, *words[2:]])
        out, err = self._capture.readouterr()
        return code, out, err


@pytest.fixture
def line(api_server: ApiServerProcess, capsys: pytest.CaptureFixture[str]) -> Line:
    return Line(api_server, capsys)


def test_tasks(line: Line, api: Api) -> None:
    code, out, _ = line.run("task", "list")
    assert (code, out.split()) == (0, ["TASK", "APPLICATION", "PRIORITY", "STATE", "REASON", "PLAN", "PULL", "REQUEST"])
    api.task("one", reason="near")
    code, out, _ = line.run("task", "list")
    assert out.splitlines()[1].split() == ["cloud-0/one", "recording", "100", "New", "near", "-", "-"]
    code, out, _ = line.run("task", "list", "--output", "json")
    assert json.loads(out)["tasks"][0]["task"] == "cloud-0/one"
    code, out, _ = line.run("task", "show", "cloud-0/one", "--output", "yaml")
    assert "application: recording" in out
    code, out, err = line.run("task", "withdraw", "cloud-0/one", "--dry-run")
    assert (code, out, err.splitlines()[0]) == (2, "", "would withdraw: cloud-0/one")
    assert "no Service manager in namespace robotkube" in err
    assert line.run("task", "withdraw", "cloud-0/one")[0] == 0
    code, out, err = line.run("task", "show", "cloud-0/one")
    assert code == 1
    assert "there is no task cloud-0/one" in err


TASK = """
metadata: {name: from-file, namespace: cloud-0}
spec: {application: recording, parameters: {vehicles: [vehicle-00]}, priority: 7}
"""


def test_submitting(line: Line, api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "task.yaml"
    file.write_text(TASK)
    submit = ("task", "submit", "-f", str(file), "--requester", "tester")
    code, out, err = line.run(*submit, "--dry-run")
    assert (code, out, err.splitlines()[1]) == (0, "", "would be submitted: cloud-0/from-file")
    assert line.run("task", "show", "cloud-0/from-file")[0] == 1
    code, out, err = line.run(*submit, "--output", "json")
    not_asked, submitted = err.splitlines()
    assert (code, json.loads(out), submitted) == (0, {"task": "cloud-0/from-file"}, "submitted: cloud-0/from-file")
    assert not_asked.startswith("the manager was not asked first: no Service manager in namespace robotkube")
    assert line.run(*submit)[2] == "unchanged: cloud-0/from-file\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(TASK))
    words = ("task", "submit", "-f", "-", "--requester", "tester", "--parameter", "vehicles=[vehicle-01]")
    not_asked, changed = line.run(*words, "--policy", "Preempt")[2].splitlines()
    assert changed == "changed: cloud-0/from-file"
    assert not_asked.startswith("the manager was not asked first: ")
    spec = json.loads(line.run("task", "show", "cloud-0/from-file", "--output", "json")[1])["spec"]
    assert (spec["parameters"], spec["priority"], spec["conflictPolicy"]) == (
        {"vehicles": ["vehicle-01"]},
        7,
        "Preempt",
    )
    assert line.run("task", "withdraw", "cloud-0/from-file")[0] == 0


def test_submitting_by_options_and_waiting(line: Line, api: Api) -> None:
    words = ("task", "submit", "--namespace", "cloud-0", "--application", "recording", "--name", "waits")
    code, out, err = line.run(*words, "--lease", "60", "--wait", "0.2", "--output", "json")
    assert (code, json.loads(out)["lease_seconds"]) == (3, 60)
    assert "not ready within 0.2 s: New" in err
    condition = {"type": "Accepted", "status": "False", "reason": "NoCapableNode", "message": "no node with lidar"}
    conditions = [{**condition, "lastTransitionTime": "2026-11-21T10:00:00Z"}]
    api.merge(f"{TASKS}/waits/status", {"status": {"observedGeneration": 1, "conditions": conditions}})
    code, out, err = line.run(*words, "--lease", "60", "--wait", "5")
    assert (code, "NoCapableNode: no node with lidar" in err) == (1, True)
    code, out, err = line.run(*words, "--lease", "60", "--wait", "5", "--delete-if-refused")
    assert (code, "not withdrawn, since it was there before: cloud-0/waits" in err) == (1, True)
    assert line.run("task", "withdraw", "cloud-0/waits")[0] == 0


def test_what_is_refused_is_withdrawn_again_when_that_is_asked_for(
    line: Line, api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not while it is postponed: it waits for its place, and then it is ready."""
    words = ("task", "submit", "--namespace", "cloud-0", "--application", "recording", "--delete-if-refused", "--wait")
    stamp = {"lastTransitionTime": "2026-11-21T10:00:00Z", "message": "no node with lidar"}
    looks = iter([("False", "Postponed"), ("False", "Postponed"), ("False", "NoCapableNode")])

    def decide(_: float) -> None:
        status, reason = next(looks)
        conditions = [{"type": "Accepted", "status": status, "reason": reason, **stamp}]
        api.merge(f"{TASKS}/refused/status", {"status": {"observedGeneration": 1, "conditions": conditions}})

    clock = SimpleNamespace(sleep=decide, monotonic=time.monotonic, time_ns=time.time_ns)  # threads have their own
    monkeypatch.setattr(submit, "time", clock)
    code, out, err = line.run(*words, "--name", "refused", "--output", "json")
    assert (code, json.loads(out)["state"]) == (1, "Refused (NoCapableNode)")
    assert "withdrawn, since it was refused: cloud-0/refused" in err
    assert line.run("task", "show", "cloud-0/refused")[0] == 1
    code, _, err = line.run("task", "submit", "--namespace", "cloud-0", "--application", "x", "--delete-if-refused")
    assert (code, "needs --wait" in err) == (2, True)


def test_watching_the_platform(line: Line, api: Api) -> None:
    """Where no manager answers, it says so, and shows what the API server has."""
    api.task("stands")
    code, out, err = line.run("watch", "--seconds=1", "--output", "json")
    events = [json.loads(text) for text in out.splitlines()]
    assert (code, err) == (0, "")
    assert events[0]["what"] == "task cloud-0/stands stands: New"
    assert events[1]["what"].startswith("what is shown may be old: the manager does not answer: no Service manager")
    assert (events[1]["trouble"], len(events)) == (True, 2)
    code, out, err = line.run("open", "--print", "fleet")
    assert (code, out) == (1, "")
    assert "no Service console; `robotkube watch` shows the fleet in the terminal" in err


def test_watching(line: Line, api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.task("watched")
    condition = {"type": "Accepted", "status": "True", "reason": "Accepted", "message": "yes"}
    conditions = [{**condition, "lastTransitionTime": "2026-11-21T10:00:00Z"}]
    api.merge(f"{TASKS}/watched/status", {"status": {"conditions": conditions}})
    write_change = watch.write_change

    def write_and_withdraw(change: Mapping[str, str], form: str, stream: TextIO) -> None:
        write_change(change, form, stream)
        if change["condition"] == "Accepted":
            api.delete(f"{TASKS}/watched")

    monkeypatch.setattr(watch, "write_change", write_and_withdraw)
    code, out, _ = line.run("task", "watch", "cloud-0/watched", "--seconds", "20", "--output", "json")
    changes = [json.loads(text) for text in out.splitlines()]
    assert (code, [row["condition"] for row in changes]) == (0, ["Submitted", "Accepted", "Withdrawn"])
    assert (changes[1]["status"], changes[1]["reason"], changes[1]["message"]) == ("True", "Accepted", "yes")
    assert changes[2]["time"] > "2026-11-21T10:00:00Z"


def test_a_watch_of_what_is_not_there_or_does_not_answer_ends_as_the_table_says(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = line.run("task", "watch", "cloud-0/gone", "--seconds", "20")
    assert (code, out) == (1, "")
    assert "there is no task cloud-0/gone" in err
    code, _, err = line.run("task", "watch", "--namespace", "nowhere", "--seconds", "0.2")
    assert (code, "no task yet in namespace nowhere" in err) == (0, True)
    silent = {
        "apiVersion": "v1",
        "kind": "Config",
        "current-context": "a",
        "contexts": [{"name": "a", "context": {"cluster": "a", "user": "a"}}],
        "clusters": [{"name": "a", "cluster": {"server": f"http://127.0.0.1:{free_port()}"}}],
        "users": [{"name": "a", "user": {}}],
    }
    (tmp_path / "kubeconfig").write_text(json.dumps(silent), encoding="utf-8")
    assert main(["task", "watch", "--kubeconfig", str(tmp_path / "kubeconfig"), "--seconds", "20"]) == 3
    assert "robotkube: " in capsys.readouterr().err


def test_an_empty_list_says_so(line: Line) -> None:
    code, out, err = line.run("task", "list", "--namespace", "nowhere")
    assert (code, len(out.splitlines()), "no tasks found" in err) == (0, 1, True)
    code, out, err = line.run("task", "list", "--namespace", "nowhere", "--output", "json")
    assert (code, json.loads(out), "no tasks found" in err) == (0, {"tasks": []}, True)


def test_every_change_is_a_line_with_its_own_time() -> None:
    """The time of the last transition stays when only reason or message change."""
    first = {"type": "Ready", "status": "False", "reason": "Progressing", "lastTransitionTime": "2026-11-21T10:00:00Z"}
    before = {"metadata": {}, "status": {"conditions": [{**first, "message": "waits"}]}}
    now = {"metadata": {}, "status": {"conditions": [{**first, "message": "starts"}]}}
    assert [change["time"] for change in watch.changes("a/b", None, before, "later")] == ["", "2026-11-21T10:00:00Z"]
    assert [(change["message"], change["time"]) for change in watch.changes("a/b", before, now, "later")] == [
        ("starts", "later")
    ]
    assert [(change["condition"], change["time"]) for change in watch.changes("a/b", now, None, "last")] == [
        ("Withdrawn", "last")
    ]


def test_times_with_and_without_microseconds_stand_in_one_column() -> None:
    stream = io.StringIO()
    rest = {"task": "a/b", "condition": "Ready", "status": "True", "reason": "Observed", "message": "all  of\nit"}
    for at in ("2026-11-21T10:00:00Z", "2026-11-21T10:00:02.482913Z", ""):
        watch.write_change({**rest, "time": at}, "table", stream)
    assert stream.getvalue().splitlines() == [
        "2026-11-21T10:00:00Z         a/b  Ready=True  Observed  all of it",
        "2026-11-21T10:00:02.482913Z  a/b  Ready=True  Observed  all of it",
        "-                            a/b  Ready=True  Observed  all of it",
    ]


def test_releases_without_any(line: Line) -> None:
    assert line.run("release", "list")[0] == 0


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("task", "show", "one"), 2, "must be <namespace>/<name>"),
        (("task", "submit", "--application", "recording"), 2, "--namespace: name the agent"),
        (("task", "submit", "--namespace", "cloud-0"), 2, "--application: name one"),
        (("task", "submit", "--namespace", "cloud-0", "--application", "x", "--parameter", "x"), 2, "write KEY=VALUE"),
        (("task", "submit", "--namespace", "nowhere", "--application", "x"), 2, "there is no namespace nowhere"),
        (("task", "submit", "--namespace", "cloud-0", "--application", "x", "--priority", "1001"), 2, "spec.priority"),
        (("task", "submit", "--namespace", "cloud-0", "--application", "x", "--wait", "0"), 2, "give seconds above 0"),
        (("task", "submit", "-f", "nowhere.yaml"), 2, "--file nowhere.yaml"),
        (("task", "watch", "--seconds", "0"), 2, "give seconds above 0"),
        (("task", "explain"), 2, "name a task that is there, or describe a new one"),
        (("trace", "abc", "--manager", "north"), 2, "no Service north in namespace robotkube"),
        (("plan", "list"), 2, "no Service manager in namespace robotkube"),
        (("registry", "search", "--platform", "--platform-namespace", "elsewhere"), 2, "in namespace elsewhere"),
    ],
)
def test_wrong_usage(line: Line, words: tuple[str, ...], code: int, text: str) -> None:
    ended, out, err = line.run(*words)
    assert (ended, out) == (code, "")
    assert text in err


def test_submitting_finds_forge_account_and_images_in_the_cluster(line: Line, api: Api) -> None:
    """The forge of this cluster does not answer: what is asked of the cluster comes first, then nothing was sent."""
    words = ("registry", "submit", "mqtt-bridge", "--platform-namespace", "submitting", "--wait", "0")
    code, _, err = line.run(*words)
    assert (code, "no Service forge in namespace submitting" in err) == (2, True)
    api.post("/api/v1/namespaces", {"metadata": {"name": "submitting"}})
    core = "/api/v1/namespaces/submitting"
    api.post(f"{core}/services", {"metadata": {"name": "forge"}, "spec": {"ports": [{"port": 3000}]}})
    code, _, err = line.run(*words)
    assert (code, "no Secret forge-account-publisher in namespace submitting" in err) == (2, True)
    account = {"username": "publisher", "password": "p"}
    api.post(f"{core}/secrets", {"metadata": {"name": "forge-account-publisher"}, "stringData": account})
    code, _, err = line.run(*words)
    assert code == 2
    assert "spec.images: no reference of mqtt-bridge (known: none); push it (robotkube image push)" in err
    data = {"images.yaml": "platform: host/platform@sha256:1\n"}
    api.post(f"{core}/configmaps", {"metadata": {"name": "platform-images"}, "data": data})
    code, _, err = line.run(*words)
    assert code == 2
    assert "(known: platform)" in err
    more = {"data": {"services.yaml": "bag-player: host/bag-player@sha256:1\n"}}
    api.merge(f"{core}/configmaps/platform-images", more)
    code, _, err = line.run(*words)
    assert (code, "(known: bag-player, platform)" in err) == (2, True)


def test_keys_that_count_are_those_given_and_those_made_in_the_cluster(api_server: ApiServerProcess, api: Api) -> None:
    names = {"context": None, "platform_namespace": "verifying", "argocd_namespace": "argocd", "manager": "manager"}
    platform = Platform(argparse.Namespace(kubeconfig=str(api_server.kubeconfig), **names))
    api.post("/api/v1/namespaces", {"metadata": {"name": "verifying"}})
    with pytest.raises(InputError, match="no public key in ConfigMap evidence-keys of namespace verifying; give"):
        platform.evidence_keys()
    maps = "/api/v1/namespaces/verifying/configmaps"
    made = {"robotkube.io/made-keys": "gate-public-key"}
    api.post(maps, {"metadata": {"name": "evidence-keys", "annotations": made}, "data": {}})
    with pytest.raises(InputError, match="no public key in ConfigMap evidence-keys or gate-public-key of namespace"):
        platform.evidence_keys()
    api.post(maps, {"metadata": {"name": "gate-public-key"}, "data": {"gate-1.pem": "one"}})
    assert platform.evidence_keys() == {"gate-1.pem": "one"}
    api.delete(f"{maps}/evidence-keys")
    api.post(maps, {"metadata": {"name": "evidence-keys"}, "data": {"mine.pem": "two"}})
    assert platform.evidence_keys() == {"mine.pem": "two"}, "a key that was made before a given one counts no more"


def test_an_unreachable_cluster(
    tmp_path: object, api_server: ApiServerProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    text = api_server.kubeconfig.read_text().replace(f":{api_server.port}", ":1")
    path = api_server.folder / "nowhere"
    path.write_text(text)
    assert main(["task", "list", "--kubeconfig", str(path)]) == 3
    assert "Connection refused" in capsys.readouterr().err


def test_grammar(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["task", "paint"])
    assert caught.value.code == 2
    assert "paint" in capsys.readouterr().err
