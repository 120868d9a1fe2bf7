"""The healthy run that tests break."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


def _healthy_run() -> ModuleType:
    """Loads the module beside this file: the tests' folders are no packages."""
    name = "scenario_healthy_run"
    if name not in sys.modules:
        specification = importlib.util.spec_from_file_location(name, Path(__file__).with_name("healthy_run.py"))
        assert specification
        assert specification.loader
        module = sys.modules[name] = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """A run that passes, as a `healthy_run.Run`."""
    return _healthy_run().healthy(tmp_path)
