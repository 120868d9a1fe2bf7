"""For all tests: modules beside this file can be imported by name; examples have no time limit of their own."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))

# a limit per example fails on a busy machine; in CI (variable CI) Hypothesis always draws the same examples
settings.register_profile("project", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")
