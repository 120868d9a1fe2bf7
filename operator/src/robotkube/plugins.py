"""What packages with rules and reactions of their own import: names that stay where they are.

A rule (entry point group `robotkube.rules`) is an `InstalledRule`: it gets an `Arrival` and a `Window`, gives
`Holding`s and may say in a `Cause` which message each goes back to. A reaction (entry point group
`robotkube.reactions`) is an `InstalledReaction`. docs/how-to/write-a-plugin.md shows a whole package.
"""

from robotkube.robots.reactions.core.plugin_api import InstalledReaction
from robotkube.robots.rules.core.events import Cause
from robotkube.robots.rules.core.plugin_api import Arrival, Holding, InstalledRule
from robotkube.robots.rules.core.windows import Columns, Pose, Reading, Window

__all__ = [
    "Arrival", "Cause", "Columns", "Holding", "InstalledReaction", "InstalledRule", "Pose", "Reading", "Window",
]  # fmt: skip
