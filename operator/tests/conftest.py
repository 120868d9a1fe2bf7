"""For all tests: modules beside this file can be imported by name; examples have no time limit of their own."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))

# on a busy machine a limit per example fails for no reason; in CI (variable CI) Hypothesis draws the same examples always
settings.register_profile("project", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")
