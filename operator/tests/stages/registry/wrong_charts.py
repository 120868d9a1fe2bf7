"""Charts that suites must refuse, one mistake each: what `registry new` writes, with that mistake made in it.

    chart, entry = wrong_chart("never-ready", folder)      # folder/charts/never-ready, folder/registry/...

Each passes `registry validate` and every suite before its own. Those whose interfaces are wrong: wrong_interfaces.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.stages.registry.wrong_interfaces import NODE, write_chart

APP, DEPLOYMENT = "charts/{name}/templates/_app.tpl", "charts/{name}/templates/deployment.yaml"
VALUES, SCHEMA = "charts/{name}/values.yaml", "charts/{name}/values.schema.json"


@dataclass(frozen=True)
class Mistake:
    """A mistake in a chart. `changes`: file -> (text, text instead). The suite that refuses it, and words of the failed
    check where it is a suite that runs nothing."""

    changes: Mapping[str, Sequence[tuple[str, str]]]
    suite: str
    check: str = ""
    found: str = ""
    fix: str = ""


# In place of the library chart's template of this name.
OWN_IMAGE = '{{ define "robotkube-app.image" }}forge.robotkube.svc.cluster.local:3000/ros:1{{ end }}'
MISTAKES: Mapping[str, Mistake] = {
    "privileged-pod": Mistake(
        {
            DEPLOYMENT: [
                (
                    '(dict "root" .)) }}',
                    '(dict "root" .)) | replace "readOnlyRootFilesystem: true" '
                    '"readOnlyRootFilesystem: true\\n          privileged: true" }}',
                )
            ]
        },
        "static",
        "pod-security/privileged",
        "container privileged-pod: privileged is true: it could do everything that root can do on the node",
        "leave privileged out of every securityContext",
    ),
    "unpinned-image": Mistake(
        {DEPLOYMENT: [('(dict "root" .)) }}', f'(dict "root" .)) }}}}{OWN_IMAGE}')]},
        "static",
        "images-by-digest",
        "image forge.robotkube.svc.cluster.local:3000/ros:1 is not named by its digest: another one could run tomorrow",
        "name it <repository>@sha256:<digest>",
    ),
    "lenient-schema": Mistake(
        {
            SCHEMA: [
                (
                    '"description": "The topics.",\n      "additionalProperties": false,',
                    '"description": "The topics.",',
                )
            ]
        },
        "static",
        "schema-strict",
        "values.relay: keys are described, but unknown ones pass",
        "write additionalProperties: false",
    ),
    "shell-entry-point": Mistake(
        {APP: [("[python3, /etc/robotkube/node.py]", '[sh, -c, "python3 /etc/robotkube/node.py; echo ended"]')]},
        "images",
        "entry-point",
        "a shell is PID 1 and passes no SIGTERM on to `python3 /etc/robotkube/node.py; echo ended`",
        "run the program itself",
    ),
    "never-ready": Mistake({NODE: [("    ready.set()\n", "")]}, "install"),
    "ignores-sigterm": Mistake(
        {NODE: [("signal.signal(number, lambda *_: stopping.set())", "signal.signal(number, signal.SIG_IGN)")]},
        "install",
    ),
}


def wrong_chart(name: str, folder: Path) -> tuple[Path, Path]:
    """Write the chart and its entry below `folder` (charts/, registry/); their paths."""
    return write_chart(name, MISTAKES[name].changes, folder)
