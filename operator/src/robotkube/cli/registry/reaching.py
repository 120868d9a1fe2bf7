"""What is reached from here: the platform of the kubeconfig, or the forge of --forge-url, with their images."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from robotkube.cli.platform import Platform
from robotkube.cli.registry.submit import ACCOUNT, ForgeAccess, forge_access
from robotkube.errors import InputError, UnavailableError
from robotkube.registry.publication.adapters import submission_folders
from robotkube.registry.suites.core.image_checks import read_reference


@dataclass(frozen=True)
class Reached:
    """What is reached from here: the forge whose OCI registry has the images, or `problem`, why none is; `images` are
    the references by digest that are known. `platform`: that of the kubeconfig, where no forge was named."""

    images: Mapping[str, str] = field(default_factory=dict)
    forge: ForgeAccess | None = None
    problem: str = ""
    platform: Platform | None = None

    def host(self) -> str:
        """The platform's OCI registry as references name it, which need not be the address at which it is reached."""
        references = [read_reference(text) for text in self.images.values()]
        hosts = {reference.host for reference in references if reference}
        return hosts.pop() if len(hosts) == 1 else urlsplit(self.needed().url).netloc

    def needed(self) -> ForgeAccess:
        """The forge; InputError when none is reached."""
        if self.forge is None:
            raise InputError(f"{self.problem}; name a cluster with --kubeconfig, or a forge with --forge-url")
        return self.forge


def reach(options: argparse.Namespace, registry: Path) -> Reached:
    """The platform of the kubeconfig or the forge of --forge-url; none of it has to be there. Images are the
    platform's and those that the file of --images or the sources in `registry` name."""
    given = submission_folders.known_images(options.images, registry)
    if options.forge_url:
        return Reached(given, forge_access(options))
    try:
        platform = Platform(options)
        images = {**platform.images(), **platform.service_images(), **given}
        return Reached(images, ForgeAccess(*platform.forge_account(ACCOUNT)), platform=platform)
    except (InputError, UnavailableError) as error:
        named = f"--kubeconfig {options.kubeconfig}" if options.kubeconfig else ""
        default = f"KUBECONFIG {os.environ['KUBECONFIG']}" if os.environ.get("KUBECONFIG") else "the default kubeconfig"
        return Reached(given, problem=f"no platform is reached by {named or default}: {error}")
