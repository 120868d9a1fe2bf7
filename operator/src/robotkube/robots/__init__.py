"""What robots say and what becomes of it: from ROS and MQTT to events and recordings."""
