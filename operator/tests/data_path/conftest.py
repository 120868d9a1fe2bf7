"""Shared by the tests of the data path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
