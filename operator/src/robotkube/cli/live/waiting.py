"""The command `robotkube wait`: a line for each component of an installation when it is ready, and what the others hang
with, until all of them are."""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import TextIO

from robotkube.cli.live.component_lines import ARGOCD, PLATFORM, ComponentLine, InstallationWatch
from robotkube.cli.platform import Platform
from robotkube.cli.terminal.printing import printable
from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.foundation.kubernetes.adapters.client import api_client

WAIT_SECONDS_MAX = 86_400.0
STEP_SECONDS = 0.1
TIME_IS_OVER = "NotReady"


def waiting(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--seconds", type=float, default=300.0, help=f"how long, at most {WAIT_SECONDS_MAX:.0f} (default: 300)"
    )


def wait_for_installation(options: argparse.Namespace) -> None:
    """Write each component of platform, gate and Argo CD when it is ready, and what hangs after half a minute without
    such a line. RefusalError: it is not all ready in time; InputError: nothing is installed there; UnavailableError:
    the API server does not answer."""
    if not 0 < options.seconds <= WAIT_SECONDS_MAX:
        raise InputError(f"--seconds {options.seconds:g}: give seconds above 0, at most {WAIT_SECONDS_MAX:.0f}")
    end = time.monotonic() + options.seconds
    namespaces = (options.platform_namespace, Platform(options).gate_namespace(), options.argocd_namespace)

    def say(line: ComponentLine) -> None:
        write_line(line, options.output, sys.stdout)

    with InstallationWatch(api_client(options.kubeconfig, options.context), namespaces, say) as followed:
        followed.wait_for_first_look()
        check_installed(followed, options)
        while followed.lines.is_waiting() or followed.complaint:
            if time.monotonic() >= end:
                end_unready(followed, options)
            time.sleep(STEP_SECONDS)
        count = sum(map(followed.lines.components, (PLATFORM, ARGOCD)))
    print(f"robotkube: ready: all {count} components in {', '.join(dict.fromkeys(namespaces))}", file=sys.stderr)


def check_installed(followed: InstallationWatch, options: argparse.Namespace) -> None:
    """InputError when there is nothing that could become ready."""
    if not followed.lines.components(PLATFORM):
        raise InputError(
            f"nothing of the platform is installed in namespace {options.platform_namespace}: install charts/robotkube "
            "by helm, or name another --platform-namespace"
        )
    if not followed.lines.components(ARGOCD):
        raise InputError(
            f"no Argo CD is installed in namespace {options.argocd_namespace}: install it, or name another "
            "--argocd-namespace"
        )


def end_unready(followed: InstallationWatch, options: argparse.Namespace) -> None:
    """Write what hangs, and raise the error that names it; nothing when the last one has become ready meanwhile."""
    if followed.complaint:
        raise UnavailableError(f"after {options.seconds:g} s what is ready is not known: {followed.complaint}")
    hanging = followed.lines.hanging()
    for line in hanging:
        write_line(line, options.output, sys.stdout)
    if hanging:
        names = ", ".join(dict.fromkeys(line.component for line in hanging))
        raise RefusalError(TIME_IS_OVER, f"after {options.seconds:g} s not ready: {names}")


def write_line(line: ComponentLine, form: str, stream: TextIO) -> None:
    """Write a line, at once: a sentence for people, a JSON document per line, or YAML documents."""
    if form == "json":
        stream.write(json.dumps(line.document(), sort_keys=True) + "\n")
    elif form == "yaml":
        stream.write(f"---\n{write_mapping(line.document())}")
    else:
        stream.write(f"{printable(line.words)}\n")
    stream.flush()
