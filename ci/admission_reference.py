"""`make reference`: the policies of charts/robotkube, from the code that makes those of the embedded cluster's files.

The chart puts the names of an installation in the places of PLACEHOLDERS.
"""

from __future__ import annotations

import json
from pathlib import Path

from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.policies import for_api

TOP = Path(__file__).resolve().parent.parent
POLICIES = TOP / "charts" / "robotkube" / "files" / "admission" / "policies.json"
PLACEHOLDERS = Domain(
    agents=("placeholder-agent",),
    tests=("placeholder-test",),
    charts="oci://placeholder.example/verified",
    platform="placeholder-platform",
    gate="placeholder-gate",
    argocd="placeholder-argocd",
)


def text() -> str:
    """The content of POLICIES."""
    return json.dumps({"items": for_api(PLACEHOLDERS)}, indent=1, sort_keys=True) + "\n"
