"""A Prometheus beside the cluster, which reads pods as PodMonitors say and evaluates the groups of a PrometheusRule:
what the Prometheus operator would make of them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import yaml

from tests.stages import http_calls
from tests.stages.programs import free_port

SECONDS = 2  # between two readings, and two looks at the rules
END_SECONDS_MAX = 30
POD = "__meta_kubernetes_pod"


@dataclass(frozen=True)
class Prometheus:
    """One that runs, by its address."""

    url: str

    def ask(self, path: str, **parameters: str) -> Any:
        """`data` of an answer of its API."""
        answer = http_calls.get(f"{self.url}/api/v1/{path}", params=parameters, timeout=30)
        assert answer.status_code == 200, answer.text
        return answer.json()["data"]

    def ready(self) -> bool:
        """Return whether it answers."""
        try:
            return http_calls.get(f"{self.url}/-/ready", timeout=5).status_code == 200
        except httpx.TransportError:
            return False

    def targets(self) -> list[Mapping[str, Any]]:
        """What it reads, with the health of each."""
        return list(self.ask("targets", state="active")["activeTargets"])

    def metrics(self) -> set[str]:
        """Names of all metrics that it has read, also of such without a series."""
        described = {one["metric"] for one in self.ask("targets/metadata")}
        return described | set(self.ask("label/__name__/values"))

    def firing(self) -> set[str]:
        """Names of the alerts that fire."""
        return {one["labels"]["alertname"] for one in self.ask("alerts")["alerts"] if one["state"] == "firing"}


def rendered(command: Sequence[str]) -> list[Any]:
    """The objects that a helm command prints."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return [one for one in yaml.safe_load_all(done.stdout) if one]


def scrape(monitor: Mapping[str, Any], kubeconfig: Path) -> dict[str, Any]:
    """The part of Prometheus' settings that a PodMonitor stands for."""
    spec = monitor["spec"]
    [endpoint] = spec["podMetricsEndpoints"]
    wanted = [(f"{POD}_label_{_plain(key)}", value) for key, value in spec["selector"]["matchLabels"].items()]
    wanted.append((f"{POD}_container_port_name", endpoint["port"]))
    labels = {"namespace": "__meta_kubernetes_namespace", "pod": f"{POD}_name"}
    labels["job"] = f"{POD}_label_{_plain(spec['jobLabel'])}"
    labels |= {_plain(label): f"{POD}_label_{_plain(label)}" for label in spec["podTargetLabels"]}
    return {
        "job_name": monitor["metadata"]["name"],
        "metrics_path": endpoint["path"],
        "kubernetes_sd_configs": [
            {
                "role": "pod",
                "kubeconfig_file": str(kubeconfig),
                "namespaces": {"names": spec["namespaceSelector"]["matchNames"]},
            }
        ],
        "relabel_configs": [
            *({"action": "keep", "source_labels": [label], "regex": value} for label, value in wanted),
            {"action": "drop", "source_labels": [f"{POD}_phase"], "regex": "Succeeded|Failed"},
            *({"source_labels": [label], "target_label": name} for name, label in labels.items()),
        ],
    }


def _plain(label: str) -> str:
    return "".join(sign if sign.isalnum() else "_" for sign in label)


@contextmanager
def running(
    program: Path, folder: Path, kubeconfig: Path, monitors: Sequence[Mapping[str, Any]], rule: Mapping[str, Any]
) -> Iterator[Prometheus]:
    """One that reads these, with its data and log below `folder`; it is ended afterwards."""
    (folder / "rules.yaml").write_text(yaml.safe_dump(rule["spec"]), encoding="utf-8")
    settings = {
        "global": {
            "scrape_interval": f"{SECONDS}s",
            "scrape_timeout": f"{SECONDS}s",
            "evaluation_interval": f"{SECONDS}s",
        },
        "rule_files": [str(folder / "rules.yaml")],
        "scrape_configs": [scrape(monitor, kubeconfig) for monitor in monitors],
    }
    (folder / "prometheus.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    address = f"127.0.0.1:{free_port()}"
    command = [str(program), f"--config.file={folder / 'prometheus.yaml'}", f"--web.listen-address={address}"]
    command.append(f"--storage.tsdb.path={folder / 'data'}")
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield Prometheus(f"http://{address}")
            assert process.poll() is None, (folder / "log").read_text("utf-8")[-2000:]
        finally:
            process.terminate()
            try:
                process.wait(END_SECONDS_MAX)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
