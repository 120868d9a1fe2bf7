"""ROS 2: subscriptions and publishers, quality of service, reading of serialised messages, buffers."""
