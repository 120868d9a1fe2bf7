"""The detector's settings of most tests: two vehicles, near within 400 m, apart beyond 500 m, and a task for it."""

from typing import Any

SETTINGS: dict[str, Any] = {
    "name": "cloud-0/event-detector",
    "topics": [{"name": "/vehicles/{agent}/pose", "type": "geometry_msgs/msg/PoseStamped"}],
    "rules": [
        {
            "name": "near",
            "kind": "proximity",
            "agents": ["vehicle-00", "vehicle-01"],
            "topic": "/vehicles/{agent}/pose",
            "start_distance_m": 400,
            "stop_distance_m": 500,
        }
    ],
    "reactions": [
        {"rule": "near", "kind": "operator", "application": "recording", "parameters": {"vehicles": "{agents}", "n": 1}}
    ],
}
