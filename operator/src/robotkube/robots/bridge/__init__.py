"""The bridge between the ROS network of a node and the MQTT broker."""
