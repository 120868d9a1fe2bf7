"""Tasks: TaskDescriptions, and the MQTT gateway through which operators ask."""
