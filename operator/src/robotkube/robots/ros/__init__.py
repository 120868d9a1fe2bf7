"""ROS 2: subscriptions and publishers, QoS profiles, reading of serialised messages, buffers."""
