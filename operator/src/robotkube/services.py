"""What services of their own import: names that stay where they are.

`WatchedSettings` follows the settings of a service whose catalogue entry says `settings: watched`: what
`robotkube registry new` writes shows it at work.
"""

from robotkube.foundation.runtime.watched_settings import WatchedSettings

__all__ = ["WatchedSettings"]
