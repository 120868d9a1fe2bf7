"""Pods of components, as far as it is told from them whether they are ready."""

from __future__ import annotations

from typing import Any

from ci.component_lines import NAME


def pod(name: str, ready: bool = False, phase: str = "Running", namespace: str = "robotkube", **status: Any) -> Any:
    """One whose component is the name without its last part."""
    labels = {NAME: name.rpartition("-")[0]}
    conditions = [{"type": "Ready", "status": str(ready), "message": "" if ready else "containers with unready status"}]
    return {
        "metadata": {"namespace": namespace, "name": name, "labels": labels},
        "status": {"phase": phase, "conditions": conditions, **status},
    }
