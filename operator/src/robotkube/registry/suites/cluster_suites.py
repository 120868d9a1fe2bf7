"""The platform's suites that need a test namespace, on their libraries: as the suite-runner and `robotkube registry
try` run them."""

from __future__ import annotations

import functools
import secrets
import time

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.suites.loops.install import InstallSuite
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.installed.memory_sampling import MemoryWatch
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.loops.interface import InterfaceSuite

_token = functools.partial(secrets.token_hex, 8)


def interface_suite(observer_image: str) -> InterfaceSuite:
    """The suite `interface`."""
    return InterfaceSuite(observer_image, Jinja2Templates().render, time.time_ns, _token)


def install_suite(observer_image: str, soak_seconds: int, memory: MemoryWatch | None = None) -> InstallSuite:
    """The suite `install`, with a soak of `soak_seconds` (0: none) in which `memory` is watched."""
    render = Jinja2Templates().render
    soak = Soak(observer_image, render, _token, soak_seconds, memory)
    return InstallSuite(render, time.time_ns, soak, SettingsChange(observer_image, render, _token))
